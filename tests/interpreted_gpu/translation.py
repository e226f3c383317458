"""From GLSL to Python generators that pause before each access to shared or writable memory, and at barriers."""

import itertools
import re
from dataclasses import dataclass
from functools import lru_cache

from gsrain_engine.presets import shipped_path
from gsrain_engine.render.opengl import shaders

from .values import (
    ALL,
    CODECS,
    COMPARED,
    LETTERS,
    MATRICES,
    OF_TYPE,
    RUNTIME,
    SAME,
    SCALAR_OF,
    SCALARS,
    VECTORS,
    Codec,
    UnsupportedError,
    array_codec,
    struct_codec,
    vector_type,
)

LOAD, STORE, ATOMIC, BARRIER, EXCHANGE = range(5)
EXCHANGES = {"subgroupBallot": "uvec4", "subgroupShuffle": "uint", "subgroupInclusiveAdd": "uint"}

INVOCATION = ("gl_LocalInvocationID", "gl_WorkGroupID", "gl_GlobalInvocationID", "gl_NumWorkGroups", "gl_WorkGroupSize")


_TOKEN = re.compile(
    r"\s*(?://.*|(?P<number>0[xX][0-9a-fA-F]+u?|\d+\.\d*(?:[eE][-+]?\d+)?|\d*\.\d+(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+|\d+u?)"
    r"|(?P<name>[A-Za-z_]\w*)|(?P<sign><<=|>>=|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=|[-+*/%&|^~!<>=?:;,.(){}\[\]]))"
)
_LEVELS = [
    ["||"], ["&&"], ["|"], ["^"], ["&"], ["==", "!="], ["<", ">", "<=", ">="], ["<<", ">>"], ["+", "-"],
    ["*", "/", "%"],
]  # fmt: skip
_ASSIGNMENTS = {"=", "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<=", ">>="}


@dataclass(frozen=True)
class _Token:
    text: str
    place: str
    """File and line."""


@dataclass
class _Operand:
    """An expression. In memory: what holds it, and the word at which it begins; a local variable: its name and path."""

    type: object
    code: str = ""
    memory: str = ""
    offset: str = ""
    place: str = ""
    name: str = ""
    path: tuple = ()


@dataclass
class _Function:
    name: str
    type: str
    parameters: list
    """Of each: out, in or inout; type; name."""
    pauses: bool = False


@dataclass
class _Symbol:
    name: str
    type: object
    kind: str
    offset: int = 0


@dataclass(frozen=True)
class Program:
    """A translated shader. `blocks`: binding and access of each storage block; `shared`: words of each variable;
    `images`: binding of each image.
    """

    name: str
    code: object
    constants: dict
    uniforms: dict
    blocks: dict
    shared: dict
    images: dict
    size: tuple


@lru_cache(maxsize=64)
def translate(text):
    """Translate a compute shader's text, after its includes."""
    return _Translator(text).program()


def _places(text):
    """File and line of each line of a shader of the package; of another text, its own lines."""
    lines = text.split("\n")
    defined = itertools.takewhile(lambda line: line.startswith("#define"), lines[1:])
    switches = {line.split()[1]: int(line.split()[2]) for line in defined if line.split()[-1].isdigit()}
    for file in shipped_path("shaders").iterdir():
        if file.name.endswith(".comp"):
            source = shaders.ShaderSource(file.name, switches)
            if source.text == text:
                return [f"{name}:{number}" for name, number in source.origins]
    return [f"line {number}" for number in range(1, len(lines) + 1)]


def _tokens(text, places):
    macros, active, found = {}, [], []
    for line, place in zip(text.split("\n"), [*places, "the end"], strict=False):
        word, _, rest = line.strip().partition(" ")
        rest = rest.partition("//")[0].strip()
        if word in ("#ifdef", "#ifndef", "#if"):
            holds = _holds(rest, macros) if word == "#if" else (rest in macros) == (word == "#ifdef")
            active.append((holds, holds))
        elif word == "#elif":
            holds = not active[-1][1] and _holds(rest, macros)
            active[-1] = holds, holds or active[-1][1]
        elif word == "#else":
            active[-1] = not active[-1][1], True
        elif word == "#endif":
            active.pop()
        elif not all(each for each, _ in active) or word in ("#version", "#extension"):
            continue
        elif word == "#define":
            name, _, value = rest.partition(" ")
            macros[name] = value
        elif word.startswith("#"):
            raise UnsupportedError(f"{place}: {word}")
        else:
            found += _line_tokens(line, place, macros)
    return found


def _line_tokens(line, place, macros):
    found, at, end = [], 0, len(line.rstrip())
    while at < end:
        match = _TOKEN.match(line, at)
        if match is None:
            raise UnsupportedError(f"{place}: {line[at:]}")
        at = match.end()
        token = match["number"] or match["name"] or match["sign"]
        if token in macros:
            found += _line_tokens(macros[token], place, {})
        elif token:
            found.append(_Token(token, place))
    return found


def _holds(condition, macros):
    replaced = re.sub(r"[A-Za-z_]\w*", lambda match: macros.get(match[0], "0"), condition)
    if not re.fullmatch(r"[\d\s<>=!]+", replaced):
        raise UnsupportedError(f"#if {condition}")
    return bool(eval(replaced, {"__builtins__": {}}))


class _Translator:
    def __init__(self, text):
        places = _places(text)
        self.name = places[0].partition(":")[0]
        self.tokens, self.at = _tokens(text, places), 0
        self.lines, self.depth, self.numbers = [], 0, itertools.count()
        self.codecs, self.functions = dict(CODECS), {}
        self.constants, self.uniforms, self.blocks, self.shared, self.images = {}, {}, {}, {}, {}
        self.size, self.steps = (1, 1, 1), []
        self.scopes = [{name: _Symbol(f"_t.{name}", "uvec3", "local") for name in INVOCATION}]
        self.scopes[0]["gl_LocalInvocationIndex"] = _Symbol("_t.index_in_group", "uint", "local")
        self.function = None

    def program(self):
        while self.at < len(self.tokens):
            self.declaration()
        code = compile("\n".join(self.lines), "translated shader", "exec")
        return Program(self.name, code, self.constants, self.uniforms, self.blocks, self.shared, self.images, self.size)

    # Tokens.

    @property
    def next(self):
        return self.tokens[self.at].text if self.at < len(self.tokens) else ""

    @property
    def place(self):
        return self.tokens[min(self.at, len(self.tokens) - 1)].place

    def take(self, expected=None):
        token = self.next
        if expected is not None and token != expected:
            raise UnsupportedError(f"{self.place}: {expected} expected, not {token}")
        self.at += 1
        return token

    def takes(self, token):
        if self.next == token:
            self.at += 1
            return True
        return False

    def separated(self):
        """Take the first token of each of the things that commas separate, and the semicolon after them."""
        yield self.take()
        while self.takes(","):
            yield self.take()
        self.take(";")

    def condition(self):
        self.take("(")
        code = self.value().code
        self.take(")")
        return code

    def emit(self, line):
        self.lines.append("    " * self.depth + line)

    def refuse(self, what):
        raise UnsupportedError(f"{self.place}: {what}")

    # Declarations.

    def is_type(self, token):
        return token in self.codecs or token in MATRICES or token == "void"

    def declaration(self):
        if self.next == "layout":
            self.layout()
        elif self.takes("struct"):
            self.struct_declaration()
        elif self.takes("shared"):
            kind = self.take()
            for name, codec in self.declared(kind):
                self.shared[f"m_{name}"] = codec.size
                self.scopes[0][name] = _Symbol(f"m_{name}", codec, "memory")
        elif self.takes("uniform"):
            kind = self.take()
            for name in self.separated():
                self.uniforms[name] = kind
                self.scopes[0][name] = _Symbol(f"u_{name}", kind, "local")
        elif self.takes("const"):
            self.constants_of()
        elif self.is_type(self.next):
            self.function_declaration()
        elif not self.takes(";"):
            self.refuse(self.next)

    def layout(self):
        self.take("layout")
        self.take("(")
        values = {}
        while not self.takes(")"):
            name = self.take()
            values[name] = self.take() if self.takes("=") else ""
            self.takes(",")
        if self.takes("in"):
            self.size = tuple(int(values.get(f"local_size_{axis}", 1)) for axis in "xyz")
            self.take(";")
            return
        access = self.take() if self.next in ("readonly", "writeonly") else "any"
        if self.takes("uniform"):
            self.take("image2D")
            name = self.take()
            self.images[name] = int(values["binding"])
            self.scopes[0][name] = _Symbol(name, "image2D", "local")
            self.take(";")
            return
        self.take("buffer")
        name = self.take()
        self.take("{")
        codec = struct_codec(name, self.members())
        self.take(";")
        if "std430" not in values:
            self.refuse("a block that is not std430")
        self.blocks[f"m_{name}"] = int(values["binding"]), access
        kind = "constant memory" if access == "readonly" else "memory"
        for member, offset, each in codec.members:
            self.scopes[0][member] = _Symbol(f"m_{name}", each, kind, offset)

    def members(self):
        members = []
        while not self.takes("}"):
            kind = self.take()
            members += [(codec, name) for name, codec in self.declared(kind)]
        return members

    def declared(self, kind):
        """Names and codecs of `kind a, b[3], c[];`, up to its semicolon."""
        found = []
        for name in self.separated():
            codec = self.codecs[kind]
            if self.takes("["):
                count = None if self.next == "]" else eval(self.expression().code, self.constant_names())
                self.take("]")
                codec = array_codec(codec, count)
            found.append((name, codec))
        return found

    def struct_declaration(self):
        name = self.take()
        self.take("{")
        self.codecs[name] = struct_codec(name, self.members())
        self.take(";")

    def constant_names(self):
        return {**RUNTIME, **self.constants}

    def constants_of(self):
        kind = self.take()
        for name in self.separated():
            self.take("=")
            value = self.converted(self.expression(), kind)
            self.constants[f"c_{name}"] = eval(value, self.constant_names())
            self.scopes[0][name] = _Symbol(f"c_{name}", kind, "local")

    def function_declaration(self):
        kind, name = self.take(), self.take()
        self.take("(")
        parameters = []
        while not self.takes(")"):
            direction = self.take() if self.next in ("in", "out", "inout") else "in"
            parameters.append((direction, self.take(), self.take()))
            self.takes(",")
        self.function = self.functions[name] = _Function(name, kind, parameters)
        self.scopes.append({each: _Symbol(f"p_{each}", type_, "local") for _, type_, each in parameters})
        self.emit(f"def f_{name}(_t{''.join(f', p_{each}' for _, _, each in parameters)}):")
        self.depth += 1
        if name == "main":
            self.function.pauses = True
            self.emit("yield from ()")
        self.take("{")
        while not self.takes("}"):
            self.statement()
        self.return_value(None)
        self.depth -= 1
        self.scopes.pop()

    # Statements.

    def block(self):
        self.depth += 1
        self.scopes.append({})
        self.emit("pass")
        if self.takes("{"):
            while not self.takes("}"):
                self.statement()
        else:
            self.statement()
        self.scopes.pop()
        self.depth -= 1

    def statement(self):
        token = self.next
        if self.takes("if"):
            self.emit(f"if {self.condition()}:")
            self.block()
            if self.takes("else"):
                self.emit("else:")
                self.block()
        elif self.takes("for"):
            self.for_loop()
        elif self.takes("while"):
            self.emit(f"while {self.condition()}:")
            self.loop([])
        elif self.takes("switch"):
            self.switch()
        elif self.takes("break"):
            self.emit("break")
            self.take(";")
        elif self.takes("continue"):
            for line in self.steps[-1]:
                self.emit(line)
            self.emit("continue")
            self.take(";")
        elif self.takes("return"):
            self.return_value(None if self.next == ";" else self.value())
            self.take(";")
        elif token in ("const", "precise") or (self.is_type(token) and self.tokens[self.at + 1].text != "("):
            self.takes(token if token in ("const", "precise") else "const")
            self.local()
        elif not self.takes(";"):
            self.action()
            self.take(";")

    def local(self):
        kind = self.take()
        for name in self.separated():
            if self.takes("["):
                count = eval(self.expression().code, self.constant_names())
                self.take("]")
                symbol = _Symbol(f"v{next(self.numbers)}_{name}", ("local array", kind), "local")
                self.emit(f"{symbol.name} = [None] * {count}")
                self.scopes[-1][name] = symbol
                continue
            # An initializer may call a function that writes a variable declared just before it.
            if self.takes("="):
                value = self.converted(self.expression(), kind)
            else:
                value = "{}" if kind not in SCALARS and kind not in VECTORS and kind not in MATRICES else "None"
            symbol = _Symbol(f"v{next(self.numbers)}_{name}", kind, "local")
            self.emit(f"{symbol.name} = {value}")
            self.scopes[-1][name] = symbol

    def for_loop(self):
        self.take("(")
        self.scopes.append({})
        self.local()
        condition = self.value().code
        self.take(";")
        body, depth, self.lines, self.depth = self.lines, self.depth, [], 0
        while self.next != ")":
            self.action()
            self.takes(",")
        step, self.lines, self.depth = self.lines, body, depth
        self.take(")")
        self.emit(f"while {condition}:")
        self.loop(step)
        self.scopes.pop()

    def loop(self, step):
        self.steps.append(step)
        self.block()
        self.steps.pop()
        self.lines += ["    " * (self.depth + 1) + line for line in step]

    def switch(self):
        value, chosen = self.condition(), f"v{next(self.numbers)}_case"
        self.take("{")
        self.emit(f"{chosen} = {value}")
        word = "if"
        while not self.takes("}"):
            if self.takes("default"):
                self.emit("else:" if word == "elif" else "if True:")
                ends = True
            else:
                self.take("case")
                self.emit(f"{word} {chosen} == {self.value().code}:")
                ends = False
            self.take(":")
            word = "elif"
            self.depth += 1
            self.emit("pass")
            while self.next not in ("case", "default", "}"):
                if self.next == "break":
                    self.take()
                    self.take(";")
                    ends = True
                    break
                ends = self.next == "return"
                self.statement()
            self.depth -= 1
            if not ends and self.next != "}":
                self.refuse("a case that falls through")

    def return_value(self, value):
        outs = [f"p_{name}" for direction, _, name in self.function.parameters if direction != "in"]
        given = "None" if value is None else self.converted(value, self.function.type)
        self.emit(f"return ({', '.join([given, *outs])},)" if outs else f"return {given}")

    def action(self):
        """An assignment, a step up or down, or a call."""
        step = self.take() if self.next in ("++", "--") else ""
        target = self.postfix()
        if not step and self.next in ("++", "--"):
            step = self.take()
        if step:
            one = _Operand("int", "1")
            self.assign(target, self.binary(step[0], self.loaded(target), one))
        elif self.next in _ASSIGNMENTS:
            sign = self.take()
            value = self.value()
            if sign != "=":
                if target.memory:  # its place is worked out once
                    at = f"v{next(self.numbers)}_at"
                    self.emit(f"{at} = {target.offset}")
                    target.offset = at
                value = self.binary(sign[:-1], self.loaded(target), value)
            self.assign(target, value)
        else:
            self.emit(self.loaded(target).code)

    def assign(self, target, value):
        kind = target.type.type if isinstance(target.type, Codec) else target.type
        code = self.converted(value, kind)
        if target.memory:
            self.function.pauses = True
            self.emit(
                f"yield ({STORE}, {target.memory}, {target.offset}, {target.place!r}, {self.codec(kind)}, {code})"
            )
        elif not target.name:
            self.refuse("an assignment to no variable")
        elif target.path:
            self.emit(f"{target.name} = put({target.name}, {target.path!r}, {code})")
        else:
            self.emit(f"{target.name} = {code}")

    def codec(self, kind):
        name = f"codec_{kind}"
        self.constants[name] = self.codecs[kind]
        return name

    # Expressions.

    def value(self):
        return self.loaded(self.expression())

    def expression(self):
        condition = self.level(0)
        if not self.takes("?"):
            return condition
        first = self.value()
        self.take(":")
        second = self.value()
        kind = self.common(first.type, second.type)
        codes = [self.converted(each, kind) for each in (first, second)]
        return _Operand(kind, f"({codes[0]} if {self.loaded(condition).code} else {codes[1]})")

    def level(self, level):
        if level == len(_LEVELS):
            return self.unary()
        left = self.level(level + 1)
        while self.next in _LEVELS[level]:
            sign = self.take()
            left = self.loaded(left)
            left = self.binary(sign, left, self.loaded(self.level(level + 1)))
        return left

    def unary(self):
        if self.next not in ("-", "+", "!", "~"):
            return self.postfix()
        sign, value = self.take(), self.loaded(self.unary())
        if sign == "!":
            return _Operand("bool", f"(not {value.code})")
        if sign == "~":
            return _Operand("uint", f"({value.code} ^ {ALL})")
        wrapped = f"(-{value.code} & {ALL})" if value.type == "uint" else f"(-{value.code})"
        return value if sign == "+" else _Operand(value.type, wrapped)

    def binary(self, sign, left, right):
        a, b = left.code, right.code
        if sign in ("&&", "||"):
            return _Operand("bool", f"({a} {'and' if sign == '&&' else 'or'} {b})")
        if left.type in SCALARS and right.type in SCALARS:
            return self.scalars(sign, left, right)
        if sign == "*" and left.type in MATRICES and right.type not in SCALARS:
            rows = MATRICES[left.type][1]
            if right.type in MATRICES:
                columns = MATRICES[right.type][0]
                return _Operand(f"mat{rows}" if columns == rows else f"mat{columns}x{rows}", f"({a} * {b})")
            return _Operand(vector_type("f", rows), f"({a} * {b})")
        if sign == "*" and right.type in MATRICES and left.type in VECTORS:
            return _Operand(vector_type("f", MATRICES[right.type][0]), f"({a} * {b})")
        if sign not in ("+", "-", "*", "/", "&", "|", "^", "<<", ">>"):
            self.refuse(f"{left.type} {sign} {right.type}")
        kind = right.type if left.type in SCALARS else left.type
        return _Operand(kind, f"({a} {sign} {b})")

    def scalars(self, sign, left, right):
        a, b = left.code, right.code
        if sign in ("==", "!=", "<", ">", "<=", ">="):
            kind = self.common(left.type, right.type)
            return _Operand("bool", f"({self.converted(left, kind)} {sign} {self.converted(right, kind)})")
        if sign in ("<<", ">>"):
            code = f"({a} {sign} ({b}))"
            return _Operand(left.type, f"({code} & {ALL})" if left.type == "uint" else f"signed({code})")
        kind = self.common(left.type, right.type)
        a, b = self.converted(left, kind), self.converted(right, kind)
        if sign == "/":
            return _Operand(kind, f"{'quotient' if kind == 'float' else 'whole_quotient'}({a}, {b})")
        if sign == "%":
            return _Operand(kind, f"remainder({a}, {b})")
        code = f"({a} {sign} {b})"
        if kind == "float":
            return _Operand(kind, code)
        return _Operand(kind, f"({code} & {ALL})" if kind == "uint" else f"signed({code})")

    def common(self, first, second):
        if first == second:
            return first
        if first in SCALARS and second in SCALARS and "bool" not in (first, second):
            return "float" if "float" in (first, second) else "uint"
        return self.refuse(f"{first} and {second}")

    def converted(self, operand, kind):
        value = self.loaded(operand)
        if value.type == kind:
            return value.code
        if kind == "float" and value.type in ("int", "uint"):
            return f"float({value.code})"
        if kind == "uint" and value.type == "int":
            return value.code if value.code.isdigit() else f"({value.code} & {ALL})"
        return self.refuse(f"{value.type} where {kind} belongs")

    def loaded(self, operand):
        """The value of an expression: read, where it is in memory."""
        if not operand.memory:
            return operand
        kind = operand.type.type
        if isinstance(kind, tuple):
            self.refuse("an array as a whole")
        request = f"{operand.memory}, {operand.offset}, {operand.place!r}, {self.codec(kind)}"
        if operand.code == "constant":
            return _Operand(kind, f"_t.load({request})")
        self.function.pauses = True
        return _Operand(kind, f"(yield ({LOAD}, {request}))")

    def postfix(self):
        operand = self.primary()
        while self.next in (".", "["):
            if self.takes("["):
                index = self.value()
                self.take("]")
                operand = self.element(operand, index)
            else:
                self.take(".")
                operand = self.field(operand, self.take())
        return operand

    def element(self, operand, index):
        if operand.memory and isinstance(operand.type.type, tuple):
            _, stride, count = operand.type.type
            at = index.code if count is None else f"_t.index({index.code}, {count}, {operand.place!r})"
            operand.offset, operand.type = f"{operand.offset} + {at} * {stride}", operand.type.members[0]
            return operand
        value = self.loaded(operand)
        if isinstance(value.type, tuple):
            part = f"{value.code}[{index.code}]"
            return _Operand(value.type[1], part, name=part)
        if value.type not in MATRICES:
            return self.refuse(f"an index of {value.type}")
        kind = vector_type("f", MATRICES[value.type][1])
        path = (*value.path, int(index.code)) if value.name and index.code.isdigit() else ()
        return _Operand(kind, f"{value.code}.parts[{index.code}]", name=value.name if path else "", path=path)

    def field(self, operand, field):
        if operand.memory and operand.type.type not in VECTORS:
            for name, offset, codec in operand.type.members:
                if name == field:
                    operand.offset, operand.type = f"{operand.offset} + {offset}", codec
                    return operand
            self.refuse(field)
        value = self.loaded(operand)
        if value.type in VECTORS:
            kind, places = VECTORS[value.type][0], tuple(LETTERS[letter] for letter in field)
            if len(places) == 1:
                code = f"{value.code}.parts[{places[0]}]"
                return _Operand(SCALAR_OF[kind], code, name=value.name, path=(*value.path, places[0]))
            return _Operand(vector_type(kind, len(places)), f"swizzled({value.code}, {places})")
        kind = {name: codec.type for name, _, codec in self.codecs[value.type].members}[field]
        return _Operand(kind, f"{value.code}[{field!r}]", name=value.name, path=(*value.path, field))

    def primary(self):
        place, token = self.place, self.take()
        if token == "(":
            value = self.value()
            self.take(")")
            return _Operand(value.type, f"({value.code})")
        if token[0].isdigit() or token[0] == ".":
            return self.literal(token)
        if token in ("true", "false"):
            return _Operand("bool", token.capitalize())
        if self.next == "(":
            return self.call(token, place)
        for scope in reversed(self.scopes):
            if token in scope:
                symbol = scope[token]
                if "memory" not in symbol.kind:
                    return _Operand(symbol.type, symbol.name, name=symbol.name)
                constant = "constant" if symbol.kind == "constant memory" else ""
                return _Operand(symbol.type, constant, symbol.name, str(symbol.offset), place)
        return self.refuse(token)

    def literal(self, token):
        if token.endswith("u"):
            return _Operand("uint", str(int(token[:-1], 0)))
        if token[:2] in ("0x", "0X") or token.isdigit():
            return _Operand("int", str(int(token, 0)))
        return _Operand("float", repr(float(token)))

    def call(self, name, place):
        self.take("(")
        arguments = []
        while not self.takes(")"):
            arguments.append(self.expression())
            self.takes(",")
        if name == "barrier":
            self.function.pauses = True
            return _Operand("void", f"(yield ({BARRIER}, None, 0, {place!r}))")
        if name in EXCHANGES:
            self.function.pauses = True
            values = ", ".join(self.loaded(each).code for each in arguments)
            return _Operand(EXCHANGES[name], f"(yield ({EXCHANGE}, None, 0, {place!r}, {name!r}, ({values},)))")
        if name in ("atomicAdd", "atomicOr"):
            target, kind = arguments[0], arguments[0].type.type
            self.function.pauses = True
            request = f"{target.memory}, {target.offset}, {place!r}, {self.codec(kind)}"
            changed = f"atomic_{name[6:].lower()}, {self.converted(arguments[1], kind)}"
            return _Operand(kind, f"(yield ({ATOMIC}, {request}, {changed}))")
        if name == "imageStore":
            self.function.pauses = True
            image, pixel = arguments[0].code, self.loaded(arguments[1]).code
            value = f"{self.codec('vec4')}, {self.converted(arguments[2], 'vec4')}"
            return _Operand("void", f"(yield ({STORE}, i_{image}, {image}_at({pixel}), {place!r}, {value}))")
        if name in self.codecs and name not in SCALARS and name not in VECTORS:
            pairs = zip(self.codecs[name].members, arguments, strict=True)
            fields = ", ".join(f"{field!r}: {self.converted(each, codec.type)}" for (field, _, codec), each in pairs)
            return _Operand(name, f"{{{fields}}}")
        values = None if name in self.functions else [self.loaded(each) for each in arguments]
        if values is None:
            return self.own_call(self.functions[name], arguments)
        codes = ", ".join(each.code for each in values)
        if name in SCALARS or name in VECTORS or name in MATRICES:
            return _Operand(name, f"constructed({name!r}, {codes})")
        kinds = [each.type for each in values]
        if name in OF_TYPE:
            return _Operand(OF_TYPE[name][0], f"g_{name}({codes})")
        if name in COMPARED:
            vectors = [each for each in kinds if each in VECTORS]
            return _Operand(vector_type("b", VECTORS[vectors[0]][1]) if vectors else "bool", f"g_{name}({codes})")
        if name not in SAME:
            self.refuse(f"{name}()")
        kind = next((each for each in kinds if each in VECTORS), None) or kinds[0]
        if kind in SCALARS and name in ("min", "max", "clamp"):
            for each in kinds[1:]:
                kind = self.common(kind, each)
            codes = ", ".join(self.converted(each, kind) for each in values)
        return _Operand(kind, f"g_{name}({codes})")

    def own_call(self, function, arguments):
        codes, outs = [], []
        for (direction, kind, _), each in zip(function.parameters, arguments, strict=True):
            codes.append(each.code if direction == "out" else self.converted(each, kind))
            if direction != "in":
                if not each.name or each.path:
                    self.refuse("only a local variable can take a result")
                outs.append(each.name)
        call = f"f_{function.name}(_t{''.join(f', {each}' for each in codes)})"
        if function.pauses:
            self.function.pauses = True
            call = f"(yield from {call})"
        if outs:
            given = f"r{next(self.numbers)}"
            filled = ", ".join(f"{name} := {given}[{k}]" for k, name in enumerate(outs, start=1))
            call = f"({given} := {call}, {filled}, {given}[0])[-1]"
        return _Operand(function.type, call)

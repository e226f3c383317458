"""A GPU made of Python: runs compute shaders thread by thread in an order of chance, and reports what nothing orders.

`InterpretedContext` stands in for a moderngl context, so that the engine's own classes hand it their shaders, buffers,
uniforms, dispatches and memory barriers. Shaders are translated from their GLSL to Python generators that pause before
each access to shared or writable memory. Threads of a workgroup then take turns by a seeded chance, one by one or as
warps of 32 in lock step, as far as the next `barrier()`.

Two accesses of one word of memory by two threads are a race, and reported, unless both only read, both are atomic, or
something orders them: `barrier()` for what a workgroup shares, `memory_barrier()` for buffers (within one dispatch,
nothing). That takes no luck: it does not depend on which of the two came first. Also reported: memory that is read
before it is written, indices out of bounds, barriers that only a part of the threads reaches, and one buffer bound for
two blocks of which one is written.

What it takes is the part of GLSL 4.30 that the project's compute shaders use; anything else is refused. Floats are
Python's, rounded to 32 bits where they are stored.
"""

import itertools
import math
import random

import moderngl
import numpy as np

from .translation import ATOMIC, BARRIER, EXCHANGE, INVOCATION, LOAD, STORE, translate
from .values import CODECS, RUNTIME, UNDEFINED, Vec, constructed

_MAX_STEPS = 20_000_000
_SUBGROUP = 32
_TURNS = 1, 1, 2, 5, 1000  # accesses in a row, by chance


class Memory:
    """Words of 32 bits, None where nobody has written, and who touched each since something last put accesses in order.

    Of each word: who loaded, stored and changed it atomically, and where. Two who differ are enough to tell a race.
    """

    def __init__(self, name, size):
        self.name, self.words, self.touched = name, [None] * size, {}


class _Thread:
    def __init__(self, machine, who, invocation):
        self.machine, self.who = machine, who
        for name, values in zip(INVOCATION, invocation, strict=True):
            setattr(self, name, Vec("u", values))
        local, size = invocation[0], invocation[4]
        self.index_in_group = local[0] + size[0] * (local[1] + size[1] * local[2])
        self.running, self.request = None, None

    def load(self, memory, at, place, codec):
        return self.machine.access(self.who, (LOAD, memory, at, place, codec))

    def index(self, at, count, place):
        if not 0 <= at < count:
            self.machine.report(f"{place} takes element {at} of {count}")
            return 0
        return at


class AwaitedFaultError(Exception):
    """A fault that a test waits for; nothing after it is run."""


class InterpretedContext(moderngl.Context):
    """The part of a context by which the engine runs compute shaders.

    Args:
        seed: Of the order in which threads take turns.
        warps: Whether 32 threads advance in lock step, as on an NVIDIA GPU before Volta, or each by itself.
        awaited: Part of a fault that ends the run by `AwaitedFaultError`.
    """

    def __init__(self, seed=0, *, warps=False, awaited=None):
        self.chance, self.warps, self.awaited = random.Random(seed), warps, awaited
        self.bindings, self.images, self.buffers, self.faults, self.shaders_run = {}, {}, [], {}, set()
        self.commands, self.steps = itertools.count(1), 0

    def __del__(self):
        pass

    @property
    def info(self):
        return {"GL_MAX_SHADER_STORAGE_BLOCK_SIZE": 1 << 27, "GL_RENDERER": "interpreted software"}

    @property
    def error(self):
        return "GL_NO_ERROR"

    def buffer(self, data=None, *, reserve=0, dynamic=False):
        made = InterpretedBuffer(self, reserve if data is None else memoryview(data).nbytes)
        if data is not None:
            made.write(data)
        return made

    def texture(self, size, components, dtype="f4"):
        return InterpretedTexture(self, size, components)

    def compute_shader(self, source):
        return InterpretedShader(self, source)

    def finish(self):
        pass

    def memory_barrier(self, barriers=0xFFFFFFFF, by_region=False):
        assert barriers == 0xFFFFFFFF, "all kinds of accesses are put in order, or this does not know which"
        for buffer in self.buffers:
            buffer.memory.touched.clear()

    def command(self):
        """A number of its own for what is handed to OpenGL; its threads follow it."""
        return next(self.commands) << 32

    def report(self, fault):
        self.faults[fault] = self.faults.get(fault, 0) + 1
        if self.awaited is not None and self.awaited in fault:
            raise AwaitedFaultError(fault)

    def access(self, who, request):
        """Do what a thread asks for, and report it where nothing puts it in order with what another one did."""
        kind, memory, at, place, codec = request[:5]
        words, end = memory.words, at + codec.size
        if at < 0 or end > len(words):
            self.report(f"{place} is outside of {memory.name}")
            return codec.decode([0] * codec.size, 0) if kind != STORE else None
        touched, me = memory.touched, (who, place)
        for word in range(at, end):
            before = touched.get(word)
            if before is None:
                touched[word] = before = [(), (), ()]  # by LOAD, STORE and ATOMIC
                before[kind] = [me]
                continue
            for other_kind, others in enumerate(before):
                for other in others:
                    if other[0] != who and (other_kind != kind or kind == STORE):
                        self.race(memory, (other[1], _VERBS[other_kind]), (place, _VERBS[kind]))
            others = before[kind]
            if not others:
                before[kind] = [me]
            elif len(others) == 1 and others[0][0] != who:
                others.append(me)
        if kind == STORE:
            words[at:end] = codec.encode(request[5])
            return None
        if codec.size == 1 and words[at] is not None and codec.type == "uint":
            value = words[at]
        elif None in words[at:end]:
            self.report(f"{place} reads of {memory.name} what nobody has written")
            return codec.decode([UNDEFINED] * codec.size, 0)
        else:
            value = codec.decode(words, at)
        if kind == ATOMIC:
            words[at:end] = codec.encode(request[5](value, request[6]))
        return value

    def race(self, memory, first, second):
        (a, b) = sorted([first, second])
        self.report(f"{a[0]} {a[1]} and {b[0]} {b[1]} {memory.name} with nothing between them")

    def run(self, program, uniforms, groups):
        """Run a dispatch: workgroups in an order of chance, one after another; their threads as the class says."""
        names = {**RUNTIME, **program.constants, **uniforms}
        for name, (binding, _) in program.blocks.items():
            names[name] = self.bindings[binding].memory if binding in self.bindings else Memory(name[2:], 0)
            names[name].name = name[2:]
        for name, binding in program.images.items():
            texture = self.images[binding]
            names[f"i_{name}"], names[f"{name}_at"] = texture.memory, texture.word
        self.check_bindings(program)
        self.shaders_run.add(program.name)
        exec(program.code, names)
        command, numbers = self.command(), list(itertools.product(*(range(each) for each in groups)))
        self.chance.shuffle(numbers)
        size = program.size
        for number, group in enumerate(numbers):
            shared = {name: Memory(name[2:], words) for name, words in program.shared.items()}
            names |= shared
            threads = []
            for local in itertools.product(*(range(each) for each in reversed(size))):
                local = local[::-1]
                at = [g * s + each for g, s, each in zip(group, size, local, strict=True)]
                who = command + number * math.prod(size) + len(threads)
                threads.append(_Thread(self, who, (local, group, at, groups, size)))
                threads[-1].running = names["f_main"](threads[-1])
            self.run_group(threads, shared.values())

    def check_bindings(self, program):
        blocks = [(name[2:], access, self.bindings.get(binding)) for name, (binding, access) in program.blocks.items()]
        for (first, a, buffer), (second, b, other) in itertools.combinations(blocks, 2):
            if buffer is other is not None and not a == b == "readonly":
                self.report(f"{first} and {second} of {program.name} are one buffer")

    def run_group(self, threads, shared):
        ready = [thread for thread in threads if self.advance(thread, None)]
        ended = len(threads) - len(ready)
        while ready:
            waiting = self.to_barrier(ready, shared)
            ended += len(ready) - len(waiting)
            if len({thread.request[3] for thread in waiting}) > 1 or (waiting and ended):
                self.report(f"not all threads come to the barrier of {waiting[0].request[3]}")
            for memory in shared:
                memory.touched.clear()
            ready = [thread for thread in waiting if self.advance(thread, None)]
            ended += len(waiting) - len(ready)

    def to_barrier(self, threads, shared):
        """Let threads take turns until each has ended or waits; returns those that wait."""
        waiting, units, meeting = [], [], {}
        if self.warps:
            for _, warp in itertools.groupby(threads, key=lambda thread: thread.who // _SUBGROUP):
                units.append(list(warp))
        else:
            units = [[thread] for thread in threads]
        while units:
            at = int(self.chance.random() * len(units))
            unit = units[at]
            for _ in range(_TURNS[int(self.chance.random() * len(_TURNS))]):
                left = []
                for thread in unit:
                    if thread.request[0] == BARRIER:
                        waiting.append(thread)
                    elif thread.request[0] == EXCHANGE:
                        there = meeting.setdefault(thread.who // _SUBGROUP, [])
                        there.append(thread)
                        if len(there) == _SUBGROUP:
                            units.append(self.met(meeting.pop(thread.who // _SUBGROUP)))
                    elif self.advance(thread, self.access(thread.who, thread.request)):
                        left.append(thread)
                unit = left
                if not unit:
                    break
            units[at] = unit
            if not unit:
                units[at] = units[-1]
                units.pop()
        for there in meeting.values():
            self.report(f"not all threads of a subgroup come to {there[0].request[3]}")
        return waiting

    def met(self, threads):
        """Let the threads of a subgroup go on from where all have come; returns those that have not ended."""
        threads.sort(key=lambda thread: thread.who)
        if len({thread.request[3] for thread in threads}) > 1:
            self.report(f"not all threads of a subgroup come to {threads[0].request[3]}")
        values = EXCHANGES[threads[0].request[4]]([thread.request[5] for thread in threads])
        return [thread for thread, value in zip(threads, values, strict=True) if self.advance(thread, value)]

    def advance(self, thread, value):
        """Run a thread as far as its next access; False where it ends instead."""
        self.steps += 1
        if self.steps > _MAX_STEPS:
            raise RuntimeError("the shader does not come to an end")
        try:
            thread.request = thread.running.send(value)
        except StopIteration:
            return False
        return True


def _ballot(given):
    return [Vec("u", (sum(bool(on) << k for k, (on,) in enumerate(given)), 0, 0, 0))] * len(given)


def _shuffle(given):
    return [given[lane][0] if lane < len(given) else UNDEFINED for _, lane in given]


def _inclusive_add(given):
    return [sum(value for (value,) in given[: k + 1]) & 0xFFFFFFFF for k in range(len(given))]


EXCHANGES = {"subgroupBallot": _ballot, "subgroupShuffle": _shuffle, "subgroupInclusiveAdd": _inclusive_add}

_VERBS = {LOAD: "reads", STORE: "writes", ATOMIC: "changes"}


class InterpretedBuffer(moderngl.Buffer):
    def __init__(self, context, size):
        self.owner, self.memory = context, Memory("a buffer", size // 4)
        context.buffers.append(self)

    def __del__(self):
        pass

    @property
    def size(self):
        return 4 * len(self.memory.words)

    def write(self, data, offset=0):
        values = np.frombuffer(memoryview(data).cast("B"), np.uint32).tolist()
        self.memory.words[offset // 4 : offset // 4 + len(values)] = values

    def read(self, size=-1, offset=0):
        end = len(self.memory.words) if size < 0 else (offset + size) // 4
        who = self.owner.command()
        for at in range(offset // 4, end):
            if self.memory.words[at] is not None:
                self.owner.access(who, (LOAD, self.memory, at, "the processor", CODECS["uint"]))
        words = self.memory.words[offset // 4 : end]
        return np.array([UNDEFINED if word is None else word for word in words], np.uint32).tobytes()

    def bind_to_storage_buffer(self, binding=0, offset=0, size=-1):
        self.owner.bindings[binding] = self

    def release(self):
        if self in self.owner.buffers:
            self.owner.buffers.remove(self)


class InterpretedTexture(moderngl.Texture):
    """Four floats a pixel, of which `read` returns the first ones."""

    def __init__(self, context, size, components):
        self.owner, self.shape, self.memory = context, (size[1], size[0], components), Memory("an image", 0)
        self.memory.words = [None] * (4 * size[0] * size[1])
        context.buffers.append(self)

    def __del__(self):
        pass

    @property
    def size(self):
        return self.shape[1], self.shape[0]

    def word(self, pixel):
        x, y = pixel.parts
        return 4 * (x + y * self.shape[1]) if 0 <= x < self.shape[1] else -1

    def bind_to_image(self, unit, read=True, write=True, level=0, format=0):
        self.owner.images[unit] = self

    def read(self):
        height, width, components = self.shape
        words = np.array([UNDEFINED if word is None else word for word in self.memory.words], np.uint32)
        return words.view(np.float32).reshape(height, width, 4)[..., :components].tobytes()


class InterpretedShader(moderngl.ComputeShader):
    def __init__(self, context, source):
        self.owner, self.program, self.uniforms = context, translate(source), {}

    def __del__(self):
        pass

    def __setitem__(self, name, value):
        kind = self.program.uniforms[name]
        values = np.ravel(value).tolist()
        self.uniforms[f"u_{name}"] = constructed(kind, *values)

    def run(self, group_x=1, group_y=1, group_z=1):
        self.owner.run(self.program, self.uniforms, (group_x, group_y, group_z))

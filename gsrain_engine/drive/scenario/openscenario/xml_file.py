"""OpenSCENARIO files as XML trees: read without trusting them, parameters put in."""

import math
import re
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from gsrain_engine.untrusted.plain_values import read_whole
from gsrain_engine.untrusted.printable import printable

_MOST = 1e9
"""No length, time, speed or angle of a scenario is more; products of such numbers are finite."""

_PARAMETER = re.compile(r"\$(\w+)")


class _NoDocumentType(ElementTree.TreeBuilder):
    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        raise ValueError("a document type: OpenSCENARIO files have none, and entities can be made to blow up")


def read_xml(path: Path) -> Element:
    """Read a file; returns its root `OpenSCENARIO` with all `$parameters` replaced by what they are declared as.

    A file with a document type is refused, so no entities are there to expand and nothing else is opened. Raises
    ValueError with the file and what is wrong.
    """
    data = read_whole(path)
    parser = ElementTree.XMLParser(target=_NoDocumentType())
    try:
        parser.feed(data)
        root: Element = parser.close()
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # LookupError: an encoding that is none
        raise ValueError(f"{path}: {printable(error)}") from None
    if root.tag != "OpenSCENARIO" or root.find("Storyboard") is None:
        raise ValueError(f"{path}: not an OpenSCENARIO scenario: there is no Storyboard in it")
    declared = {each.get("name", ""): each.get("value", "") for each in root.iter("ParameterDeclaration")}
    for element in root.iter():
        for name, value in element.attrib.items():
            if value.startswith("$") and element.tag != "ParameterDeclaration":
                element.set(name, _put_in(path, element, name, value, declared))
    return root


def _put_in(path: Path, element: Element, name: str, value: str, declared: dict[str, str]) -> str:
    match = _PARAMETER.fullmatch(value)
    if match is None or match[1] not in declared:
        raise ValueError(f'{path}: {element.tag}@{name}="{value}": only declared parameters are put in, no expressions')
    return declared[match[1]]


def number(path: Path, element: Element, name: str) -> float:
    """Return an attribute as a number; raises ValueError with the file, the element and what stands there."""
    value = element.get(name)
    try:
        found = float(value or "")
    except ValueError:
        found = math.nan
    if not abs(found) <= _MOST:
        stands = "is missing" if value is None else f'is "{value}"'
        raise ValueError(f"{path}: {element.tag}@{name} {stands}: expected a number")
    return found


def properties(element: Element) -> dict[str, str]:
    """Return what stands in an element's own `Properties`."""
    found = element.find("Properties")
    return {} if found is None else {each.get("name", ""): each.get("value", "") for each in found.findall("Property")}

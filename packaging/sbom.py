"""Complete a list of components (CycloneDX JSON) by the licences that packages tell only in their texts.

`make sbom` runs it with the Python whose packages were listed.
"""

import json
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

from licences import UNKNOWN, licence_of


def complete(components: dict[str, Any]) -> None:
    """Add an SPDX expression to each component without a licence."""
    for component in components["components"]:
        if not component.get("licenses"):
            expression = licence_of(metadata.distribution(component["name"]))
            if expression != UNKNOWN:
                component["licenses"] = [{"expression": expression}]


if __name__ == "__main__":
    file = Path(sys.argv[1])
    listed = json.loads(file.read_text("utf-8"))
    complete(listed)
    file.write_text(json.dumps(listed, indent=2) + "\n", "utf-8")

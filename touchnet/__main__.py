"""`touchnet COMMAND ...` and `python -m touchnet COMMAND ...`."""

import importlib
import json
import sys
from collections.abc import Sequence

from touchnet import cli

COMMANDS = {
    "reconstruct": "a closed mesh from a file of touches",
    "view": "contacts, mesh and where to touch next, on a page in the browser",
    "explore": "where to touch next, given the touches so far",
    "simulate": "touches and labelled points from meshes, as a data set",
    "train": "train a network (without arguments: on the embedded data set)",
    "evaluate": "measure weights on a data set, beside baselines",
}


def usage() -> str:
    """The text of `touchnet --help`."""
    lines = [f"  {name:<13}{what}" for name, what in COMMANDS.items()]
    return "\n".join(
        [
            "usage: touchnet COMMAND [OPTION...]",
            "",
            "Closed triangle meshes from touching trajectories.",
            "",
            *lines,
            "",
            "  --version    the version",
            "  --build-info the version and how the extension was built, as JSON",
            "  --help       this text; `touchnet COMMAND --help` for the options of a command",
        ]
    )


@cli.command("touchnet")
def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command named by the first argument; returns the exit status."""
    name, *rest = (sys.argv[1:] if argv is None else list(argv)) or [""]
    if name in ("-h", "--help", "help"):
        print(usage())
        return 0
    if name == "--version":
        from importlib.metadata import version

        print(f"touchnet {version('touchnet')}")
        return 0
    if name == "--build-info":
        from touchnet import build_info

        print(json.dumps(build_info(), indent=2))
        return 0
    if name not in COMMANDS:
        came = f"got {name!r}" if name else "got none"
        raise ValueError(f"expected a command out of {', '.join(COMMANDS)}, {came} (see touchnet --help)")
    return importlib.import_module(f"touchnet.{name}").main(rest)


if __name__ == "__main__":
    sys.exit(main())

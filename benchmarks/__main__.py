"""python -m benchmarks [NAME...] [--json FILE]: run the registered benchmarks whose name contains one of the NAMEs."""

import argparse
import importlib
import json
import pkgutil
import platform
from pathlib import Path

import torch

import benchmarks
import touchnet
from benchmarks.cases import CLOCKS, HEADER, REGISTRY, measure, row


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=benchmarks.__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="run benchmarks whose name contains NAME (default: all)"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results to FILE")
    parser.add_argument("--list", action="store_true", help="list the benchmarks and exit")
    parser.add_argument("--threads", type=int, default=torch.get_num_threads(), help="threads of torch and touchnet")
    parser.add_argument("--no-allocator", action="store_true", help="leave the memory allocator of both sides as it is")
    parser.add_argument("--clock", choices=CLOCKS, default="wall", help="cpu: processor time, for a busy machine")
    arguments = parser.parse_args()

    for module in pkgutil.iter_modules(benchmarks.__path__):
        if module.name != "__main__":
            importlib.import_module(f"benchmarks.{module.name}")
    chosen = [name for name in REGISTRY if not arguments.names or any(part in name for part in arguments.names)]
    if arguments.list:
        print("\n".join(REGISTRY))
        return
    if not chosen:
        parser.error(f"no benchmark matches; there are {', '.join(REGISTRY)}")

    torch.set_num_threads(arguments.threads)
    tuned = not arguments.no_allocator and touchnet.tune_allocator()
    machine = {
        "processor": processor(),
        "threads": torch.get_num_threads(),
        "clock": arguments.clock,
        "torch": torch.__version__,
        "allocator_keeps_memory": tuned,
        **touchnet.build_info(),
    }
    print(", ".join(f"{key} {value}" for key, value in machine.items()), flush=True)
    results = []
    widths = [58, 9, 28, 7, 14, 0]
    for name in chosen:
        print(f"\n{name}")
        print("  ".join(cell.ljust(width) for cell, width in zip(HEADER, widths, strict=True)).rstrip())
        for case in REGISTRY[name]():
            result = measure(case, arguments.clock)
            results.append({"benchmark": name, **result.record()})
            print(
                "  ".join(cell.ljust(width) for cell, width in zip(row(result), widths, strict=True)).rstrip(),
                flush=True,
            )
    if arguments.json:
        arguments.json.write_text(json.dumps({"machine": machine, "results": results}, indent=2) + "\n")


def processor() -> str:
    """The processor's name where the system tells it."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


if __name__ == "__main__":
    main()

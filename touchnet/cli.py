"""What the commands share: parsing, and answering bad input with one line and an exit status."""

import contextlib
import functools
import io
import os
import signal
import sys
import threading
import types
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

import tyro

BAD_INPUT = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells report it
TERMINATED = 143  # 128 + SIGTERM
BROKEN_PIPE = 141  # 128 + SIGPIPE

T = TypeVar("T")


def one_line(error: BaseException) -> str:
    """The message of `error` on one line; of an OSError `path: reason` instead of `[Errno n] reason: 'path'`."""
    if isinstance(error, OSError) and error.strerror and error.filename is not None:
        text = f"{os.fsdecode(error.filename)}: {error.strerror}"
    else:
        text = str(error) or type(error).__name__
    return " ".join(text.split())


def command(name: str) -> Callable[[Callable[[Sequence[str] | None], int | None]], Callable[..., int]]:
    """Decorator that makes the `main(argv)` of a command answer bad input with one line and an exit status.

    The decorated function takes the arguments (`None`: those of the process) and returns the exit status: what the
    body returned (`None`: 0), 2 after a ValueError, OSError, ImportError or lack of memory, 130 after Ctrl-C, 143 after
    SIGTERM, 141 when the reader of a pipe went away. Warnings become one line each. Any other exception is a defect of
    the program and keeps its traceback; `TOUCHNET_DEBUG=1` keeps it for all of them.

    Args:
        name: the name in front of messages, such as "touchnet reconstruct".
    """

    def decorate(body: Callable[[Sequence[str] | None], int | None]) -> Callable[..., int]:
        @functools.wraps(body)
        def main(argv: Sequence[str] | None = None) -> int:
            def fail(message: str, status: int) -> int:
                if os.environ.get("TOUCHNET_DEBUG", "") not in ("", "0"):
                    raise
                print(f"{name}: error: {message}", file=sys.stderr)
                return status

            with _one_line_warnings(name), _terminate_like_interrupt():
                try:
                    status = body(argv)
                    sys.stdout.flush()
                    return status or 0
                except SystemExit as leave:
                    if isinstance(leave.code, str):
                        return fail(leave.code, BAD_INPUT)
                    return leave.code or 0
                except KeyboardInterrupt:
                    return fail("interrupted", INTERRUPTED)
                except BrokenPipeError:
                    # Whatever is still buffered would raise again while the interpreter shuts down.
                    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
                    return BROKEN_PIPE
                except (ValueError, OSError, ImportError) as error:
                    return fail(one_line(error), BAD_INPUT)
                except (MemoryError, RuntimeError) as error:
                    if not _is_lack_of_memory(error):
                        raise
                    return fail(f"not enough memory ({one_line(error)})", BAD_INPUT)

        return main

    return decorate


def parse(
    options_type: Callable[..., T],
    argv: Sequence[str] | None,
    *,
    prog: str,
    config: Sequence[Any] = (),
    **options: Any,
) -> T:
    """`tyro.cli` whose complaints are one line on stderr, followed by exit status 2.

    Args:
        options_type: the dataclass (or annotated callable) that describes the options.
        argv: the arguments, `None` for those of the process.
        prog: the name shown in usage and messages.
        config: markers of tyro, beside ours.
        options: passed on to `tyro.cli`.

    Raises:
        SystemExit: 0 after --help, 2 after arguments that do not fit.
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            # A flag has one name: --force, without --no-force beside it. What is not given is None, which nobody types.
            config = (tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone, *config)
            return tyro.cli(options_type, args=argv, prog=prog, config=config, registry=_registry(), **options)
    except SystemExit as leave:
        if not leave.code:
            raise
        print(f"{prog}: error: {_inside_of_box(said.getvalue())} (see {prog} --help)", file=sys.stderr)
        raise SystemExit(BAD_INPUT) from None


def _registry() -> tyro.constructors.ConstructorRegistry:
    """How --help writes a default of None: unset."""
    registry = tyro.constructors.ConstructorRegistry()

    @registry.primitive_rule
    def unset(info: tyro.constructors.PrimitiveTypeInfo) -> tyro.constructors.PrimitiveConstructorSpec | None:
        if info.type is not type(None):
            return None
        return tyro.constructors.PrimitiveConstructorSpec(
            nargs=1,
            metavar="",
            instance_from_str=lambda words: None,
            is_instance=lambda value: value is None,
            str_from_instance=lambda value: ["unset"],
            choices=(),
        )

    return registry


def _inside_of_box(text: str) -> str:
    """What the frame that tyro draws around its errors says, without the pointers to --help."""
    paragraphs: list[list[str]] = [[]]
    for line in text.splitlines():
        line = line.strip()
        if line.startswith(("╭", "╰", "+")):
            continue
        line = line.strip("│|").strip()
        if set(line) <= set("─-"):
            paragraphs.append([])
        else:
            paragraphs[-1] += line.split()
    said = [
        " ".join(words) for words in paragraphs if words and words[:2] != ["For", "full"] and words[0] != "Argument"
    ]
    return "; ".join(said) or "the arguments do not fit"


def _is_lack_of_memory(error: BaseException) -> bool:
    # torch.OutOfMemoryError is looked up by name: importing torch here would slow every --help down.
    return (
        isinstance(error, MemoryError)
        or type(error).__name__ == "OutOfMemoryError"
        or "can't allocate memory" in str(error)
    )


@contextlib.contextmanager
def _one_line_warnings(name: str) -> Iterator[None]:
    def show(message: Any, category: type, filename: str, lineno: int, file: Any = None, line: Any = None) -> None:
        kind = "warning" if issubclass(category, UserWarning) else category.__name__
        print(f"{name}: {kind}: {' '.join(str(message).split())}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


@contextlib.contextmanager
def _terminate_like_interrupt() -> Iterator[None]:
    """While inside, SIGTERM raises SystemExit, so that temporary files are removed as after Ctrl-C."""

    def leave(signum: int, frame: types.FrameType | None) -> None:
        raise SystemExit(TERMINATED)

    usual = threading.current_thread() is threading.main_thread() and signal.getsignal(signal.SIGTERM) == signal.SIG_DFL
    if usual:
        signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        if usual:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)

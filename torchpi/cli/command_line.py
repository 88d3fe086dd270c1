"""User interface of torchpi's commands: typed functions give options; an error is one line, exit code 2."""

import argparse
import atexit
import contextlib
import difflib
import inspect
import io
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from types import FrameType
from typing import Any, NoReturn, TextIO, get_args, get_origin

import jsonargparse
import yaml

from torchpi.errors import ConfigError, ExportWarning, RecordingWarning, TorchpiError
from torchpi.files import check_yaml, read_yaml_text, reason

UNSAFE = ("importlib._bootstrap", "llvmlite.binding")
"""Modules that are active while a library loads or LLVM compiles. Both call back into Python, where an
exception may end in a segmentation fault."""
ENDED = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
INTERRUPTED, TERMINATED = 130, 143  # exit codes: 128 and the number of the signal


def run_chosen(
    commands: Sequence[Callable[..., None]],
    program: str,
    description: str,
    version: str,
    parsers_below: Mapping[str, Callable[[], Mapping[str, Any]]],
) -> None:
    """Parse the command line and call the function that it names.

    The signature of a command gives its options, the docstring its help, and the function its name, without a
    trailing underscore. `parsers_below` serves shell completion of commands that parse their own arguments.
    """
    # Line buffering shows progress at once, also through a pipe; stdout may be missing.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)
    completion = any(word.startswith("--print_completion") for word in sys.argv[1:])
    if completion and find_spec("shtab") is None:
        raise ConfigError("--print_completion needs shtab; run: pip install 'torchpi[completion]'")
    jsonargparse.set_parsing_settings(add_print_completion_argument=True)  # needs shtab installed
    parser = Parser(prog=program, description=description, version=version, formatter_class=_Formatter)
    subcommands = parser.add_subcommands(title="commands", description=None)
    functions = {command.__name__.removesuffix("_"): command for command in commands}
    for name, command in functions.items():
        text, _, _ = inspect.getdoc(command).partition("\n\nArgs:")  # type: ignore[union-attr]
        subparser = Parser(description=text, formatter_class=_Formatter)
        subparser.add_function_arguments(command, as_group=False, as_positional=True)
        subcommands.add_subcommand(name, subparser, help=text.splitlines()[0])
        if completion and name in parsers_below:
            below = subparser.add_subcommands()
            for word, parser_below in parsers_below[name]().items():
                below.add_subcommand(word, parser_below)
    chosen = parser.instantiate_classes(parser.parse_args())
    functions[chosen.subcommand](**chosen[chosen.subcommand])


class _Formatter(argparse.RawDescriptionHelpFormatter, jsonargparse.DefaultHelpFormatter):
    """Formats help with the line breaks of descriptions kept."""


def _load_yaml(text: str) -> Any:
    """Load YAML as jsonargparse does, but refuse documents that aliases make too large to walk."""
    check_yaml(text, MOST_VALUES)
    return LOAD_YAML(text)


MOST_VALUES = 1000  # limited, because jsonargparse copies a list once for each of its values
LOAD_YAML = jsonargparse.get_loader("yaml")
jsonargparse.set_loader("yaml", _load_yaml, (yaml.YAMLError,))


class Parser(jsonargparse.ArgumentParser):
    """A parser that reports errors in one line and suggests the nearest valid option."""

    def parse_path(self, cfg_path: str | os.PathLike[str], *args: Any, **kwargs: Any) -> Any:
        """Parse a file as jsonargparse does, after checking that it is small enough for settings."""
        if str(cfg_path) != "-":  # standard input
            read_yaml_text(cfg_path, MOST_VALUES)
        return super().parse_path(cfg_path, *args, **kwargs)

    def add_argument(self, *args: Any, **kwargs: Any) -> Any:
        """Add an argument as argparse does, with two differences.

        `for_`, named so because `for` is a Python keyword, becomes `--for`; and a positional list takes one
        word after another, as a shell expands a wildcard.
        """
        action = super().add_argument(*args, **kwargs)
        kind = getattr(action, "_typehint", None)
        if not action.option_strings and get_origin(kind) is list:
            action.nargs, action._typehint = "+", get_args(kind)[0]
        for option in [option for option in action.option_strings if option.endswith("_")]:
            action.option_strings.remove(option)
            action.option_strings.append(option.removesuffix("_"))
            self._option_string_actions[option.removesuffix("_")] = self._option_string_actions.pop(option)
            action.metavar = action.dest.removesuffix("_").upper()
        return action

    def error(self, message: str, ex: Exception | None = None) -> NoReturn:
        cause: BaseException | None = ex
        while cause is not None:
            # A torchpi error raised while a value was constructed already has the complete message.
            if isinstance(cause, TorchpiError):
                raise cause
            cause = cause.__cause__ or cause.__context__
        text = one_line(message, list(option_names(self)))
        value = re.search(r'Parser key "(?P<key>[\w.]+)": .*(?:Given|Got) value: (?P<found>.*)$', text)
        if value:
            text = f"{value['key']}: found {value['found']}, expected {self.expected(value['key'])}"
        raise ConfigError(re.sub(r'Parser key "([\w.]+)"', r"\1", text)) from ex

    def expected(self, key: str) -> str:
        """Return the type of an option as its help names it."""
        for action in self._actions:
            choices = getattr(action, "_name_parser_map", None) or {}
            for name, parser in choices.items():
                inner = key.removeprefix(f"{name}.")
                if isinstance(parser, Parser) and any(other.dest == inner for other in parser._actions):
                    return parser.expected(inner)
            hint = getattr(action, "_typehint", None)
            if action.dest == key and hint is not None:
                text = re.sub(r"<class '(?:[\w]+\.)*(\w+)'>|\b(?:\w+\.)+(\w+)", r"\1\2", str(hint))
                text = re.sub(r"Literal\[(.*?)\]", r"\1", text)
                return re.sub(r"Optional\[(.*)\]", r"\1 or null", text).replace(" | None", " or null")
        return "a value of the type that --help states"


def run_command(command: Callable[[], Any], program: str) -> int:
    """Run `command` and return the exit code. Errors in the user's input and warnings about recordings become
    one line each on stderr."""
    try:
        with warnings.catch_warnings(), _signals_as_exceptions(program), _silent_writers():
            _show_in_one_line(program)
            command()
            if sys.stdout is not None:
                sys.stdout.flush()
    except TorchpiError as error:
        return _failed(program, str(error))
    except Terminated:
        return _ended(program, signal.SIGTERM)
    except KeyboardInterrupt:
        return _ended(program, signal.SIGINT)
    except BrokenPipeError:
        _discard_output()
        return 1
    except OSError as error:
        _discard_output()
        where = error.filename if isinstance(error.filename, str) else "standard output or a temporary file"
        return _failed(program, f"{where}: {reason(error)}")
    except MemoryError as error:
        return _failed(program, f"not enough memory ({str(error) or 'amount unknown'})")
    except RecursionError:
        return _failed(program, "a value is nested too deeply")
    except RuntimeError as error:
        if "can't allocate memory" not in str(error):  # torch raises this in place of a MemoryError
            raise
        return _failed(program, f"not enough memory ({str(error).rpartition(': ')[2]})")
    return 0


@contextmanager
def _silent_writers() -> Iterator[None]:
    """Suppress tracebacks of threads that cannot write, such as TensorBoard's; the next write raises."""
    before = threading.excepthook

    def hook(args: threading.ExceptHookArgs) -> None:
        if not isinstance(args.exc_value, OSError):
            before(args)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = before


def run_program(command: Callable[[], Any], program: str) -> NoReturn:
    """Run `command` and end this process with its exit code.

    Slow imports belong inside `command`, so that an interrupt during them is also reported in one line.
    """
    code = run_command(command, program)
    if code in (INTERRUPTED, TERMINATED):
        _exit_at_once(code)
    # All files are written; an interrupt while Python exits would only add a traceback.
    for number in (signal.SIGINT, signal.SIGTERM):
        atexit.register(signal.signal, number, signal.SIG_IGN)
    sys.exit(code)


def _exit_at_once(code: int) -> NoReturn:
    """End this process after an interrupt. Python's normal exit would wait for the threads of a pool whose
    workers were killed, possibly for ever."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    # A worker that is still starting would report the semaphores removed next as missing.
    for worker in getattr(sys.modules.get("multiprocessing"), "active_children", list)():
        worker.kill()
    if finalizers := getattr(sys.modules.get("multiprocessing.util"), "_run_finalizers", None):
        finalizers(0)  # removes semaphores without joining threads
    os._exit(code)


def _ended(program: str, number: int) -> int:
    word = ENDED[signal.Signals(number)]
    print(f"{program}: {word}; files already written are complete", file=sys.stderr)
    return 128 + number


def _failed(program: str, text: str) -> int:
    print(f"{program}: error: {' '.join(text.splitlines())}", file=sys.stderr)
    return 2


def _discard_output() -> None:
    """Redirect stdout to null, because text still buffered for an unwritable output would fail at exit."""
    if sys.stdout is not None:
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)


class Terminated(KeyboardInterrupt):
    """Raised on SIGTERM, so that the command ends as after an interrupt."""


@contextmanager
def _signals_as_exceptions(program: str) -> Iterator[None]:
    """Turn SIGTERM into `Terminated`; otherwise the process would end silently and its workers go on.
    A signal is sent again if its exception was lost where Python lets none out, such as in the callback of a
    weak reference. Where no exception is safe, the process ends at once, and its workers with it."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        if _unsafe(frame):
            _exit_at_once(_ended(program, number))
        raise Terminated if number == signal.SIGTERM else KeyboardInterrupt

    def again(lost: "sys.UnraisableHookArgs") -> None:
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            usual(lost)
        else:
            number = signal.SIGTERM if isinstance(lost.exc_value, Terminated) else signal.SIGINT
            threading.Timer(0.01, os.kill, (os.getpid(), number)).start()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before, usual = [signal.signal(number, end) for number in numbers], sys.unraisablehook
    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = usual
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def _unsafe(frame: FrameType | None) -> bool:
    """Whether a library is being loaded, or LLVM is compiling."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith(UNSAFE):
            return True
        frame = frame.f_back
    return False


def _show_in_one_line(program: str) -> None:
    """Print torchpi's own warnings without their line of source code, and others as Python does."""
    usual = warnings.showwarning

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, (RecordingWarning, ExportWarning)):
            print(f"{program}: warning: {message}", file=file or sys.stderr)
        else:
            usual(message, category, filename, lineno, file, line)

    warnings.showwarning = show  # catch_warnings restores the usual one


def option_names(parser: jsonargparse.ArgumentParser) -> Iterator[str]:
    """Yield the dotted names of all options of a parser and its subcommands."""
    for action in parser._actions:
        choices = getattr(action, "_name_parser_map", None) or {}
        for name, subparser in choices.items():
            yield name
            yield from option_names(subparser)
        yield action.dest.removesuffix("_")


def one_line(message: str, known: list[str]) -> str:
    """Return the message in one line without lists, with the nearest valid name if a name was wrong."""
    text = re.sub(r"\s+", " ", message).strip()
    wrong = re.search(
        r"(?:[Uu]nrecognized arguments: --|Key '|[Nn]ested key '|Option '|No action for key \"?)([\w.\-]+)",
        text,
    )
    if wrong:
        name = wrong.group(1)
        # A nested key is reported without its parents, so the last part of each name is compared as well.
        candidates = {option: option for option in known} | {
            option.split(".")[-1]: option for option in known
        }
        nearest = difflib.get_close_matches(name, candidates, n=1, cutoff=0.5)
        hint = f"; nearest is '{candidates[nearest[0]]}'" if nearest else ""
        return f"unknown option or key '{name}'{hint}; --help lists all"
    return text

"""The functions of the API as commands: a verb is one call, and the answer that its result gives."""

from __future__ import annotations

import inspect
import pkgutil
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.abc import InspectLoader
from importlib.util import find_spec
from typing import Annotated, Any

from cyclopts import App, Parameter
from cyclopts.exceptions import CycloptsError, MissingArgumentError, UnusedCliTokensError
from rich.table import Table

from hulldown.base.code import package_version
from hulldown.base.terminal import print_message, print_warning
from hulldown.verbs.output import DONE, print_json, print_lines_and_tables

VERB_GROUPS = {"study": "Measure the worth of synthetic images when photographs are few."}
PYTHON_PARAMETERS = ("assets", "library", "progress", "say")  # they aren't options of a verb
JSON_OPTION = Annotated[bool, Parameter(help="Print the result as JSON on stdout.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class VerbOutput:
    """What a verb prints, and its exit code."""

    result: object  # on stdout with --json
    shown: Sequence[str | Table] = ()  # on stdout without --json
    said: Sequence[str] = ()  # on stderr
    warnings: Sequence[str] = ()  # on stderr, after `said`
    code: int = DONE


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb of the command line: its function, and how its result is printed."""

    function: str  # of the API: "planning.check:check_plan"
    answer: Callable[..., VerbOutput]  # from the function's result, and arguments that it has names of
    resumes: bool = False  # whether the same command continues after a stop

    @property
    def summary(self) -> str:
        """The first paragraph of the function's docstring, read without importing its module."""
        module, _, name = self.function.partition(":")
        spec = find_spec(f"hulldown.{module}")
        source = spec and isinstance(spec.loader, InspectLoader) and spec.loader.get_source(spec.name)
        found = re.search(rf'^def {name}\(.*?"""(.*?)(?:\n\n|""")', source or "", re.MULTILINE | re.DOTALL)
        assert found is not None, self.function
        return " ".join(found[1].split())

    def make_command(self) -> Callable[..., int]:
        """Return the function with --json and -o; it shows its result and returns the exit code."""
        function = pkgutil.resolve_name(f"hulldown.{self.function}")
        signature = inspect.signature(function, eval_str=True)
        asked = list(inspect.signature(self.answer).parameters)[1:]

        def run(*arguments: object, json: bool = False, **options: object) -> int:
            given = signature.bind(*arguments, **options)
            answer = self.answer(function(*given.args, **given.kwargs), **_named_arguments(given, asked))
            if json:
                print_json(answer.result)
            else:
                print_lines_and_tables(*answer.shown)
            for line in answer.said:
                print_message(line)
            for line in answer.warnings:
                print_warning(line)
            return answer.code

        last = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=JSON_OPTION)
        options = [_command_parameter(one) for name, one in signature.parameters.items() if name not in PYTHON_PARAMETERS]
        options.sort(key=lambda one: one.kind)  # an output that isn't positional follows the inputs
        run.__doc__, run.__annotations__ = function.__doc__, {}
        vars(run)["__signature__"] = inspect.Signature([*options, last], return_annotation=int)
        return run


def _named_arguments(given: inspect.BoundArguments, names: Sequence[str]) -> dict[str, Any]:
    given.apply_defaults()
    return {name: given.arguments[name] for name in names}


def _command_parameter(parameter: inspect.Parameter) -> inspect.Parameter:
    if parameter.name == "output":
        parameter = parameter.replace(annotation=Annotated[parameter.annotation, Parameter(alias="-o")])
    elif parameter.default is inspect.Parameter.empty:
        return parameter
    return parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)


def _shown_default(value: object) -> str | None:
    if value is None or value is False or value == ():
        return None
    return ",".join(map(str, value)) if isinstance(value, tuple) else str(value)


def find_verb_name(words: Sequence[str], verbs: Mapping[str, Verb]) -> str | None:
    """Return the verb that the words begin with; None if there is none."""
    return next((name for name in verbs if list(words[: len(name.split())]) == name.split()), None)


def describe_parser_error(error: CycloptsError) -> str:
    """Describe in one line what is wrong with a command's words."""
    if isinstance(error, MissingArgumentError) and (argument := error.argument) and not error.tokens_so_far:
        name = argument.names[0].lstrip("-").upper()
        if error.keyword is not None:
            return f"{error.keyword} has no value"
        return f"{name if argument.index is not None else f'{argument.names[-1]} {name}'} is missing"
    if isinstance(error, UnusedCliTokensError):
        return f"unexpected words: {' '.join(error.unused_tokens or ())}"
    return " ".join(str(error).split())


def run_command(words: Sequence[str], verbs: Mapping[str, Verb]) -> int:
    """Run a verb, or show help, and return the exit code."""
    app = make_command_app(words, verbs)
    code: int | None = app(words, exit_on_error=False, print_error=False, result_action="return_value")
    return code or DONE


def make_command_app(words: Sequence[str], verbs: Mapping[str, Verb]) -> App:
    """Return the command; only the verb in `words` is imported, and the list of verbs has the others."""
    app = App(
        name="hulldown",
        help="Plan, render and annotate synthetic detection datasets of vehicles on terrain.",
        version=package_version("hulldown") or "unknown",
        version_flags=("--version",),
        default_parameter=Parameter(negative=(), show_default=_shown_default),
        suppress_keyboard_interrupt=False,
    )
    wanted = find_verb_name(words, verbs)
    for place, (name, verb) in enumerate(verbs.items()):
        *groups, last = name.split()
        room = app
        for group in groups:
            if group not in room:
                room.command(App(name=group, help=VERB_GROUPS[group], sort_key=place))
            room = room[group]
        if name == wanted:
            room.command(verb.make_command(), name=last)
        elif wanted is None:
            room.command(App(name=last, help=verb.summary, sort_key=place))
    return app

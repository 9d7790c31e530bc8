"""Command ``completion``: a script by which bash completes commands, options and choices, without starting Python."""

import argparse
from collections.abc import Iterator
from functools import partial
from typing import Any

from hpcinv.cli.help import add_command

_SCRIPT = """_hpcinv() {{
    local IFS=$' \\t\\n' words= options= current=${{COMP_WORDS[COMP_CWORD]}}
    case "${{COMP_WORDS[*]:1:COMP_CWORD - 1}} " in
{cases}
    esac
    [[ $current == -* ]] && words=$options
    COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o bashdefault -o default -F _hpcinv hpcinv"""
"""It takes names of files where no word fits."""


def add_completion(commands: Any) -> None:
    completion = add_command(
        commands,
        "completion",
        "Print a script by which bash, or zsh after 'bashcompinit', completes commands and options.",
        examples="hpcinv completion > ~/.local/share/bash-completion/completions/hpcinv",
        page="start/installing.md",
    )
    completion.set_defaults(command=partial(_print, commands.choices))


def _print(parsers: dict[str, argparse.ArgumentParser], _options: argparse.Namespace) -> int:
    print(_SCRIPT.format(cases="\n".join(f"        {case};;" for case in _cases("", parsers))))
    return 0


def _cases(typed: str, parsers: dict[str, argparse.ArgumentParser]) -> Iterator[str]:
    """Yield patterns of what is typed already, the longest first, with the words or options that may follow."""
    for name, parser in parsers.items():
        words, options = list[str](), list[str]()
        for action in parser._actions:
            choices = " ".join(map(str, action.choices or ()))
            if isinstance(action, argparse._SubParsersAction):
                yield from _cases(f"{typed}{name} ", action.choices)
            options += action.option_strings
            if choices and action.option_strings:
                patterns = "|".join(f'"{typed}{name}"*" {option} "' for option in action.option_strings)
                yield f"{patterns}) words='{choices}'"
            elif choices:
                words.append(choices)
        yield f"\"{typed}{name} \"*) words='{' '.join(words)}' options='{' '.join(options)}'"
    if not typed:
        yield f"' ') words='{' '.join(parsers)}' options='-h --help --version'"

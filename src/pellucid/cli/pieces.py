"""Work in pieces, for farms that run one command a piece: what the options mean, and the commands of all pieces."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from pathlib import Path

import click

ARGUMENTS = "pellucid.arguments"
PRINT = "--print-commands"

MOST_TILES = 1 << 16


class PieceNumber(click.ParamType):
    """A tile, and the number of tiles."""

    name = "K/N"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Read ``3/16``."""
        number, slash, count = value.partition("/")
        if not (slash and number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count) <= MOST_TILES):
            self.fail(
                f"'{value}' is no tile: give its number, from 1 on, and how many there are, as in 3/16.", param, ctx
            )
        return int(number), int(count)


class FrameRange(click.ParamType):
    """The first and the last of some frames."""

    name = "A-B"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> range:
        """Read ``12-24``, or ``12`` for one frame."""
        first, dash, last = value.partition("-")
        last = last if dash else first
        if not (first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
            self.fail(f"'{value}' are no frames: give the first and the last, counted from 0, as in 12-24.", param, ctx)
        return range(int(first), int(last) + 1)


class InPieces(click.Command):
    """A command that remembers its arguments, so that it can say how its pieces are asked for."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Keep a copy."""
        ctx.meta[ARGUMENTS] = list(args)
        return super().parse_args(ctx, args)


print_commands = click.option(
    PRINT,
    "commands",
    type=click.IntRange(1, MOST_TILES),
    metavar="N",
    help="Render nothing; print the commands of N pieces, one a line, and on standard error the one that merges them.",
)


def piece_commands(pieces: Iterable[list[str]]) -> None:
    """Print the command that is running, once for each list of options that make a piece of it."""
    ctx = click.get_current_context()
    arguments = _without(ctx.meta[ARGUMENTS], (PRINT, "-o", "--output"))
    for options in pieces:
        click.echo(shlex.join(["pellucid", str(ctx.info_name), *arguments, *options]))


def merge_command(output: Path, pieces: Iterable[Path], options: Iterable[str] = ()) -> None:
    """Print the command that puts pieces together, where it does not mix with their own."""
    click.echo("# then: " + shlex.join(["pellucid", "merge", *options, str(output), *map(str, pieces)]), err=True)


def _without(arguments: list[str], names: tuple[str, ...]) -> list[str]:
    """Leave out options that take a value, however they are written."""
    kept, skip = [], False
    for argument in arguments:
        if skip or argument in names:
            skip = argument in names and not skip
        elif not any(argument.startswith(f"{name}=") for name in names) and not (
            argument.startswith("-o") and not argument.startswith("--")
        ):
            kept.append(argument)
    return kept

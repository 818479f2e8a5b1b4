"""Tab completion of values: the words, files and folders that an option or argument can take."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import rich_click as click
from click.shell_completion import CompletionItem, FishComplete, add_completion_class

Items = list[CompletionItem[str]]
#: Gives the completions of an incomplete value. The context has the values that were typed before it.
Completer = Callable[[click.Context, str], Items]

#: The environment variable by which a shell asks for completions.
VARIABLE = "_TACBENCH_COMPLETE"
#: Files by which a run folder is recognised: that of a finished import or run, and the table of targets.
RUN_FILES = ("run.json", "targets.csv")
#: Folders that are looked into for runs before the search gives up.
MAX_FOLDERS = 500


class _Fish(FishComplete):
    """Fish, whose script in click cuts a value off at its first comma."""

    source_template = FishComplete.source_template.replace('string split "," ', 'string split --max 1 "," ')


add_completion_class(_Fish)


def nothing(ctx: click.Context, incomplete: str) -> Items:
    """No completion: a value that only the user knows, for example a number."""
    return []


def of_files(ctx: click.Context, incomplete: str) -> Items:
    """Files and folders, which the shell lists itself."""
    return [CompletionItem(incomplete, type="file")]


def of_folders(ctx: click.Context, incomplete: str) -> Items:
    """Folders, which the shell lists itself."""
    return [CompletionItem(incomplete, type="dir")]


def of_words(*words: str) -> Completer:
    """One of some words."""
    return lambda ctx, incomplete: [CompletionItem(word) for word in words if word.startswith(incomplete)]


def of_words_or_files(*words: str) -> Completer:
    """One of some words, or a file if no word fits."""

    def complete(ctx: click.Context, incomplete: str) -> Items:
        return of_words(*words)(ctx, incomplete) or of_files(ctx, incomplete)

    return complete


def of_lists(*words: str, suffix: str | None = None) -> Completer:
    """Words with commas between them. A word that is already in the list is not offered again.

    Args:
        words: The words.
        suffix: Files with this suffix are offered as well, and all files where no word fits.
    """

    def complete(ctx: click.Context, incomplete: str) -> Items:
        typed, comma, start = incomplete.rpartition(",")
        before = typed.split(",")
        choices = [*words, *(() if suffix is None else _paths(start, lambda path: path.suffix == suffix))]
        items = [
            CompletionItem(f"{typed}{comma}{word}")
            for word in choices
            if word.startswith(start) and word.partition("=")[0] not in (item.partition("=")[0] for item in before)
        ]
        return items if items or suffix is None or comma else of_files(ctx, incomplete)

    return complete


def of_run_folders(ctx: click.Context, incomplete: str) -> Items:
    """Run folders and folders that hold some; every folder where there are none."""
    items = [CompletionItem(path) for path in _paths(incomplete, _holds_runs)]
    return items or of_folders(ctx, incomplete)


def of_printers(ctx: click.Context, incomplete: str) -> Items:
    """The printers that are known, and those of the file that ``--printers`` names."""
    return of_words(*_printers(ctx))(ctx, incomplete)


def of_filaments(ctx: click.Context, incomplete: str) -> Items:
    """The filaments of the printer that ``--printer`` names, or those of all printers."""
    printers = _printers(ctx)
    tables = [printers[name] for name in printers if ctx.params.get("printer") in (None, name)]
    return of_words(*dict.fromkeys(name for table in tables for name in table))(ctx, incomplete)


def _printers(ctx: click.Context) -> dict[str, list[str]]:
    """The filaments of each printer. The files are not checked here: the command itself does that."""
    from tacbench_cad.slicing import printers

    names: dict[str, list[str]] = {}
    for file in (printers.OWN_FILE, ctx.params.get("printers")):
        if file is not None:
            try:
                tables = tomllib.loads(Path(file).read_text(encoding="utf-8"))["printer"]
                names |= {name: list(table["filaments"]) for name, table in tables.items()}
            except (OSError, ValueError, LookupError, TypeError, AttributeError):
                continue
    return names


def _paths(start: str, fits: Callable[[Path], bool]) -> Iterator[str]:
    """The paths that begin with ``start`` and fit, written as they were begun."""
    folder, slash, name = start.rpartition("/")
    for path in _entries(Path(folder + slash) if slash else Path()):
        if path.name.startswith(name) and (name or not path.name.startswith(".")) and fits(path):
            yield f"{folder}{slash}{path.name}"


def _entries(folder: Path) -> Iterable[Path]:
    try:
        return sorted(folder.iterdir())[:MAX_FOLDERS]
    except OSError:
        return ()


def _holds_runs(folder: Path) -> bool:
    """Whether a folder is a run folder, or has one directly in it."""
    return folder.is_dir() and any(
        (inner / name).is_file() for inner in (folder, *_entries(folder)) for name in RUN_FILES
    )

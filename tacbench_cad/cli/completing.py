"""Tab completion of values: the words, files and folders that an option or argument can take."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import rich_click as click
from click.shell_completion import CompletionItem, FishComplete, add_completion_class

from tacbench_cad.util.entries import entries

Items = list[CompletionItem[str]]
#: A function that returns the completions of an incomplete value. The context has the values that are already typed.
Completer = Callable[[click.Context, str], Items]

#: The environment variable by which a shell asks for completions.
VARIABLE = "_TACBENCH_COMPLETE"
#: A folder with one of these files is a run folder; a test compares them with the files of the lab.
RUN_FILES = ("run.json", "targets.csv")
#: At most so many entries of a folder are considered.
MAX_ENTRIES = 500


class _Fish(FishComplete):
    """Completion for fish. The script in click cuts a value off at its first comma; this script keeps it whole."""

    source_template = FishComplete.source_template.replace('string split "," ', 'string split --max 1 "," ')


add_completion_class(_Fish)


def nothing(ctx: click.Context, incomplete: str) -> Items:
    """Offer nothing, for a value that only the user knows, for example a number."""
    return []


def of_files(ctx: click.Context, incomplete: str) -> Items:
    """Let the shell list files and folders."""
    return [CompletionItem(incomplete, type="file")]


def of_folders(ctx: click.Context, incomplete: str) -> Items:
    """Let the shell list folders."""
    return [CompletionItem(incomplete, type="dir")]


def of_words(*words: str) -> Completer:
    """Offer these words."""
    return lambda ctx, incomplete: [CompletionItem(word) for word in words if word.startswith(incomplete)]


def of_features(ctx: click.Context, incomplete: str) -> Items:
    """Offer the features of the analysis."""
    return of_words(*entries("tacbench.features"))(ctx, incomplete)


def of_words_or_files(*words: str) -> Completer:
    """Offer these words. If none fits, let the shell list files."""

    def complete(ctx: click.Context, incomplete: str) -> Items:
        return of_words(*words)(ctx, incomplete) or of_files(ctx, incomplete)

    return complete


def of_lists(*words: str, suffix: str | None = None) -> Completer:
    """Offer words for a list that is separated by commas. A word that is already in the list is not offered again.

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
    """Offer run folders and folders that contain run folders. If there are none, let the shell list folders."""
    items = [CompletionItem(path) for path in _paths(incomplete, _holds_runs)]
    return items or of_folders(ctx, incomplete)


def of_simulated_stages(ctx: click.Context, incomplete: str) -> Items:
    """Offer the drivers of simulated stages."""
    from tacbench_cad.lab.rig.registry import simulated_stages

    return of_words(*simulated_stages())(ctx, incomplete)


def _paths(start: str, fits: Callable[[Path], bool]) -> Iterator[str]:
    """The paths that begin with ``start`` and fit."""
    folder, slash, name = start.rpartition("/")
    for path in _entries(Path(folder + slash) if slash else Path()):
        if path.name.startswith(name) and (name or not path.name.startswith(".")) and fits(path):
            yield f"{folder}{slash}{path.name}"


def _entries(folder: Path) -> Iterable[Path]:
    try:
        return sorted(folder.iterdir())[:MAX_ENTRIES]
    except OSError:
        return ()


def _holds_runs(folder: Path) -> bool:
    """Whether a folder is a run folder or directly contains one."""
    return folder.is_dir() and any(
        (inner / name).is_file() for inner in (folder, *_entries(folder)) for name in RUN_FILES
    )

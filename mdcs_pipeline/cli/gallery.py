"""What ``mdcs view`` is given: clouds, skeletons, or both side by side."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mdcs_pipeline.errors import InputError, nearest_name, suggestion

if TYPE_CHECKING:
    from mdcs_pipeline.viewer.film import Frame

# What `Skeleton.load` reads back; the others hold no more than a part of a skeleton.
_READABLE = (".json", ".npz")
_PARTIAL = (".graphml", ".swc", ".png", ".html")


def sort_paths(paths: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return the clouds and the skeletons among `paths`; a folder counts as what it holds.

    Raises
    ------
    InputError
        If a file is a skeleton that cannot be read back, or there are several clouds or
        folders that do not go together.
    """
    for path in paths:
        _check_there(path)
    clouds = [path for path in paths if not _holds_skeletons(path)]
    skeletons = [path for path in paths if _holds_skeletons(path)]
    for path in clouds:
        if path.suffix.lower() in _PARTIAL or _is_line_set(path):
            raise InputError(
                "this format does not hold all of a skeleton",
                where=str(path),
                remedy="view the .json or .npz of it",
            )
    for kind, found in (("cloud", clouds), ("skeleton", skeletons)):
        if len(found) > 1:
            raise InputError(
                f"more than one {kind}",
                received=", ".join(map(str, found)),
                remedy="put the files into one folder and give that: it becomes a sequence",
            )
    return clouds, skeletons


def _check_there(path: Path) -> None:
    if path.exists():
        return
    near = sorted(p.name for p in path.parent.iterdir()) if path.parent.is_dir() else []
    raise InputError(
        "no such file or folder",
        where=str(path),
        remedy=suggestion(path.name, near)
        if nearest_name(path.name, near)
        else "is the path relative to another folder?",
    )


def _holds_skeletons(path: Path) -> bool:
    if path.is_dir():
        from mdcs_pipeline.io.clouds import CLOUD_SUFFIXES

        known = (*CLOUD_SUFFIXES, *_READABLE)
        files = [file for file in _visible(path) if file.suffix.lower() in known]
        return bool(files) and all(_holds_skeletons(file) for file in files)
    return path.suffix.lower() == ".json" or (path.suffix.lower() == ".npz" and _is_record(path))


def _visible(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]


def _is_record(path: Path) -> bool:
    """Return whether an archive is a skeleton's; a damaged one is for its reader to refuse."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            return "node_ids.npy" in archive.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _is_line_set(path: Path) -> bool:
    """Return whether a PLY file holds edges, as a skeleton's does and no cloud's."""
    if path.suffix.lower() != ".ply" or not path.is_file():
        return False
    with path.open("rb") as stream:
        head = stream.read(4096).partition(b"end_header")[0]
    return b"\nelement edge " in head


def skeleton_frames(clouds: list[Path], skeletons: list[Path]) -> list[Frame]:
    """Return a frame for each skeleton, with the cloud of the same name behind it.

    Raises
    ------
    InputError
        If a file cannot be read, or a skeleton has no cloud while others do.
    """
    from mdcs_pipeline.io.clouds import frame_files, read_points
    from mdcs_pipeline.skeleton import Skeleton
    from mdcs_pipeline.viewer.film import Frame

    files = [file for path in skeletons for file in _files(path)]
    behind = [f for path in clouds for f in (frame_files(path) if path.is_dir() else [path])]
    frames = []
    for file in files:
        cloud = _partner(file, behind, alone=len(files) == len(behind) == 1)
        skeleton = Skeleton.load(file)
        points = None if cloud is None else read_points(cloud)
        frames.append(Frame(file.name, points, skeleton))
    return frames


def _files(path: Path) -> list[Path]:
    from mdcs_pipeline.io.clouds import natural_key

    if not path.is_dir():
        return [path]
    files = (file for file in _visible(path) if file.suffix.lower() in _READABLE)
    return sorted(files, key=natural_key)


def _partner(skeleton: Path, clouds: list[Path], alone: bool) -> Path | None:
    if not clouds:
        return None
    if alone:
        return clouds[0]
    # `mdcs run` names them a.json, or a.ply.json where two clouds share a stem.
    fitting = [c for c in clouds if skeleton.stem in (c.stem, c.name)]
    if len(fitting) != 1:
        raise InputError(
            f"{len(fitting) or 'no'} clouds have the skeleton's name",
            where=str(skeleton),
            remedy="name each pair alike, as 'mdcs run' does, or leave out the clouds",
        )
    return fitting[0]

"""Files: read whole after a look at their size, arrays and JSON in one, tables as text, pictures, foreign files.

Calibrations and results are arrays and one JSON string, without pickles: written completely or not at all, checked when
read. `numpy.load` opens them too.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import os
import re
import shutil
import stat
import time
import tokenize
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePath
from typing import Any, BinaryIO

import numpy as np

from gelform.arrays import Array
from gelform.errors import DataError, GelformError, cannot, said
from gelform.foundations.checks import check_path, remedy_for

try:
    import fcntl
except ImportError:  # Windows: partial files of killed processes stay
    fcntl = None  # type: ignore[assignment]


_PICKLE = (
    "It is a pickle. Reading one can run code, so gelform does not. If you trust it, save its frames where it was made: "
    'numpy.save("frames.npy", frames).'
)
_ARCHIVE = "It is an archive. Unpack it, and give the folder."
_WEIGHTS = (
    "It may be the network of another package. Make a calibration of it: gelform import {name} --from gs_sdk --background "
    "rest.png -o cal.npz (or --from gsrobotics)."
)


def conversion_of_bag(name: str, stem: str) -> str:
    """The command that makes a bag that gelform reads."""
    return f"Convert it: rosbags-convert --src {name} --dst {stem}_mcap --dst-storage mcap (pip install rosbags)."


WAYS = {
    ".npz": "It is an archive of arrays. Save the frames alone: "
    'numpy.save("frames.npy", numpy.load("{name}")["NAME"]).',
    **dict.fromkeys((".pkl", ".pickle", ".p"), _PICKLE),
    **dict.fromkeys((".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar"), _ARCHIVE),
    **dict.fromkeys((".pth", ".pt"), _WEIGHTS),
    ".mat": "It may be the look-up table of another package. Make a calibration of it: gelform import {name} --from lut "
    "--background rest.png -o cal.npz.",
    ".tmd": "It is a height map of GelSight's scanner software: measured already, with nothing to reconstruct. "
    "gelform reads the sensor's images.",
    ".bag": "It is a bag of ROS 1. " + conversion_of_bag("{name}", "{stem}"),
    ".db3": "It is a part of a bag of sqlite3. " + conversion_of_bag("FOLDER", "{stem}"),
    **dict.fromkeys(
        (".dng", ".raw", ".cr2", ".nef", ".arw", ".heic"), "Save it as PNG, with 8 bits for each color."
    ),
}


def way_for(path: str | os.PathLike[str]) -> str:
    """A sentence with what to do with a file of a kind that is not read, after a space; empty for other kinds."""
    name = PurePath(path)
    way = WAYS.get(name.suffix.lower(), "")
    return way and " " + way.replace("{name}", name.name).replace("{stem}", name.stem)


MAX_TEXT_BYTES = 2**24  # of settings, of facts about a data set
MAX_ARRAY_BYTES = 2**28  # of an array in another program's file, or of a table as text


def bytes_of(
    path: str | os.PathLike[str], what: str, max_bytes: float, error: type[GelformError] = DataError
) -> bytes:
    """The content of a file of at most `max_bytes`; `what` describes it in errors.

    error: there is no such file, it is a folder, a pipe or a device, larger than that, or cannot be read.
    """
    path = present_file(path, what, max_bytes, error)
    try:
        with cannot(f"read {path}", error=error):
            return path.read_bytes()
    except MemoryError:
        raise error(f"Not enough memory to read {path}.") from None


def present_file(
    path: str | os.PathLike[str],
    what: str,
    max_bytes: float = MAX_ARRAY_BYTES,
    error: type[GelformError] = DataError,
) -> Path:
    """The path of a file that exists and is not too large; the error says that `what` was expected."""
    path = check_path(path)
    try:
        if path.is_dir():
            raise error(f"Expected a file, got the folder {path}.")
        if path.exists() and not path.is_file():  # reading a pipe or a device could block forever
            raise error(
                f"Expected a file, got a pipe or a device: {path}. Save what it gives as a file first."
            )
        size = path.stat().st_size
    except FileNotFoundError:
        raise error(f"No file {path}: expected {what}. {remedy_for(path)}") from None
    except OSError as problem:
        raise error(f"Cannot read {path}: {problem.strerror or problem}.") from problem
    if size > max_bytes:
        raise error(
            f"Expected {what} of at most {max_bytes / 1e6:.4g} MB, got {path} of {size / 1e6:.4g} MB. It is damaged, or "
            "another file."
        )
    return path


# A spreadsheet runs text that begins so (OWASP, CSV injection); one more apostrophe keeps text that has some already.
_FORMULA = re.compile(r"'*[=+\-@\t\r]")


def table_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows of cells as lines of a CSV file; an apostrophe comes before text that a spreadsheet would run as a formula."""
    lines = []
    for row in rows:
        text = io.StringIO()  # with another end of lines, a lone carriage return would not be quoted
        csv.writer(text).writerow(f"'{cell}" if _is_formula(cell) else cell for cell in row)
        lines.append(text.getvalue().removesuffix("\r\n") + "\n")
    return "".join(lines)


def plain_cell(cell: str) -> str:
    """A cell as it was before `table_text`."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _is_formula(cell: Any) -> bool:
    if not isinstance(cell, str) or not _FORMULA.match(cell):
        return False
    try:
        float(cell)
    except ValueError:
        return True
    return False


LEFT_FILE = re.compile(r"\.gelform-[0-9a-f]{12}\.tmp")
DIGEST_SHOWN = 10  # characters of a digest in names and lists: a million calibrations share one with a chance of one half
LEFT_AFTER_S = 60.0  # seconds; a younger file may not be locked yet
MAX_BYTES, MAX_META_BYTES = 2**30, 2**26  # bytes of all members of an archive, and of its settings
_RESERVED = ("format", "format_version", "gelform_version", "digest")
# Errors that zipfile, zlib and numpy's reader of arrays raise for a damaged archive.
DAMAGED_ARCHIVE = (
    zipfile.BadZipFile,
    zlib.error,
    EOFError,
    NotImplementedError,
    MemoryError,  # an array may declare more memory than any machine has
    RuntimeError,
    SyntaxError,
    tokenize.TokenError,
    UnicodeDecodeError,
)
_UNREADABLE = (*DAMAGED_ARCHIVE, ValueError, KeyError)
PICTURE_STARTS = (
    b"\x89PNG",
    b"\xff\xd8\xff",
    b"BM",
    b"II*\0",
    b"MM\0*",
    b"RIFF",
)  # PNG, JPEG, BMP, TIFF, WebP


@contextmanager
def written_file(
    path: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    flushed: bool = True,
    error: type[GelformError] = DataError,
) -> Iterator[BinaryIO]:
    """Open a file for writing that appears under its name only if the block succeeds.

    The bytes go to a temporary file in the same folder, which gets the name in one step (`named_file`). If anything
    fails (disk full, an exception in the block), the temporary file is deleted and the file at `path` stays.
    Without `flushed`, a loss of power may lose the file until the system has written it to the disk.

    error: as `check_free`; or the folder is not writable or full.
    """
    target = check_free(path, overwrite=overwrite, error=error)
    temporary = target.parent / f".gelform-{os.urandom(6).hex()}.tmp"
    try:
        with open(temporary, "x+b") as handle:
            locked(handle.fileno())
            yield handle
            handle.flush()
            if flushed:
                os.fsync(handle.fileno())
            with suppress(OSError):  # a file system without times
                os.utime(temporary)  # the file has no lock from now on; `sweep` leaves it alone for a minute
        named_file(temporary, path, overwrite=overwrite, error=error)
    except BaseException as problem:
        temporary.unlink(missing_ok=True)
        if not isinstance(problem, OSError):
            raise
        why = f"Cannot write {path}: {problem.strerror or problem}. Nothing of it was kept."
        raise error(why) from problem


def named_file(
    temporary: Path, path: str | os.PathLike[str], *, overwrite: bool, error: type[GelformError] = DataError
) -> None:
    """Give a finished file its name in the same folder, in one step; without `overwrite`, one of all who try succeeds.

    error: as `check_free`. OSError: the system refuses; the temporary file is still there then.
    """
    target = check_free(path, overwrite=overwrite, error=error)  # again: the work took time
    if overwrite:
        os.replace(temporary, target)
        return
    try:
        os.link(temporary, target)  # a rename would replace what another process has just written
    except FileExistsError:
        raise _taken(target, error) from None
    except OSError:  # a file system without hard links, or one that is full
        try:
            target.open("xb").close()
        except FileExistsError:
            raise _taken(target, error) from None
        try:
            os.replace(temporary, target)
        except OSError:
            target.unlink(missing_ok=True)
            raise
    else:
        temporary.unlink()


def _taken(path: Path, error: type[GelformError]) -> GelformError:
    return error(
        f"{path} is already there. Choose another name, or allow it to be replaced: overwrite=True (--overwrite)."
    )


def locked(descriptor: int) -> bool:
    """Lock an open file or folder until it is closed or its process ends; False if that is impossible."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (OSError, AttributeError):
        return False
    return True


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock a partial folder while it is filled, if the system can; `sweep` leaves it alone."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        locked(descriptor)
        yield
    finally:
        os.close(descriptor)


def sweep(folder: Path, target: str = "") -> None:
    """Delete the partial files that killed processes left in a folder, or the partial folders of a target's name.

    Files that a running process has locked stay, and so do files that changed within the last minute.
    """
    names = re.compile(re.escape(f".{target}.partial-") + "([a-z0-9_]{8}|[0-9]+)") if target else LEFT_FILE
    try:
        found = [path for path in folder.iterdir() if names.fullmatch(path.name) and not path.is_symlink()]
    except OSError:  # a folder that can be written to, but not listed
        return
    for left in found:
        if not (left.is_dir() if target else left.is_file()):
            continue
        try:
            descriptor = os.open(left, os.O_RDONLY)
        except OSError:  # another process has just removed it, or it belongs to another user
            continue
        try:
            # Check the age before and after: the lock must not hinder an owner that is still writing or about to rename.
            if _is_old(descriptor) and locked(descriptor) and _is_old(descriptor):
                if target:
                    shutil.rmtree(left, ignore_errors=True)
                else:
                    left.unlink(missing_ok=True)
        finally:
            os.close(descriptor)


def _is_old(descriptor: int) -> bool:
    return time.time() - os.fstat(descriptor).st_mtime > LEFT_AFTER_S


def made_folder(folder: Path) -> Path:
    """The folder, made with its parents where it is missing.

    DataError: it is a file, or the system refuses.
    """
    with cannot(f"make the folder {folder}"):
        if folder.is_file():
            raise DataError(f"Expected a folder to write to, got the file {folder}.")
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def check_free(
    path: str | os.PathLike[str], *, overwrite: bool, error: type[GelformError] = DataError
) -> Path:
    """The file that a name stands for, if one may be written there: the target of a symbolic link, else the name's own.

    error: a file or a link has the name already (unless `overwrite`); it is a folder, a device, a pipe or a socket; its
    folder is missing.
    """
    path = check_path(path)
    with cannot(f"write {path}", error=error):
        # A link of links that leads to itself stays one.
        target = Path(os.path.realpath(path)) if path.is_symlink() else path
        if not target.parent.is_dir():
            folder = target.parent
            raise error(f"Cannot write {path}: its folder {folder} does not exist. Make it first.")
        kind = stat.S_IFMT(target.lstat().st_mode) if os.path.lexists(target) else None
    if kind == stat.S_IFDIR:
        raise error(f"Expected a file name to write to, got the folder {path}. Add a name: {path / 'name'}.")
    if kind not in (None, stat.S_IFREG):
        what = _KINDS.get(kind, "special file")
        raise error(
            f"Expected a file or a free name to write to, got the {what} {path}. Choose another name, and copy the file "
            "from there."
        )
    if os.path.lexists(path) and not overwrite:
        raise _taken(path, error)
    return target


_KINDS = {
    stat.S_IFCHR: "device",
    stat.S_IFBLK: "device",
    stat.S_IFIFO: "pipe",
    stat.S_IFSOCK: "socket",
    stat.S_IFLNK: "circle of symbolic links",
}


def write_npz(
    path: str | os.PathLike[str],
    arrays: Mapping[str, Array],
    meta: Mapping[str, Any],
    *,
    kind: str,
    version: int,
    overwrite: bool = False,
    error: type[GelformError] = DataError,
) -> None:
    """Write named arrays of numbers, booleans or text, and settings, to one `.npz` without pickles: whole or not at all.

    The settings are in the member `meta`, as JSON, beside `format` (the kind, such as "gelform calibration"),
    `format_version` (from 1), `gelform_version` and a `digest` (SHA-256) over arrays and settings.

    error: as `written_file`. ValueError, TypeError: settings that JSON cannot hold (NaN included), an array of objects, or a
    reserved name.
    """
    members = _members_to_write(arrays, meta, kind, version)
    with written_file(path, overwrite=overwrite, error=error) as handle:
        _write_members(handle, members)


def npz_bytes(arrays: Mapping[str, Array], meta: Mapping[str, Any], *, kind: str, version: int) -> bytes:
    """The bytes that `write_npz` writes, without a digest, for a file whose digest is kept elsewhere.

    `read_npz` refuses them.
    """
    content = io.BytesIO()
    _write_members(content, _members_to_write(arrays, meta, kind, version, digest=False))
    return content.getvalue()


def _members_to_write(
    arrays: Mapping[str, Array], meta: Mapping[str, Any], kind: str, version: int, digest: bool = True
) -> dict[str, Array]:
    from gelform import __version__

    prepared = {name: np.asarray(values) for name, values in arrays.items()}
    for name, array in prepared.items():
        if array.dtype.hasobject:
            raise TypeError(f"Expected {name} as numbers, booleans or text, got an array of objects.")
    clashes = [name for name in _RESERVED if name in meta] + (["meta"] if "meta" in arrays else [])
    if clashes:
        raise ValueError(f"Expected other names than the reserved {', '.join(clashes)}.")
    full = {"format": kind, "format_version": version, "gelform_version": __version__, **meta}
    if digest:
        full = json.loads(_json(full))
        full["digest"] = digest_of(prepared, full)
    return {"meta": np.array(_json(full)), **prepared}


def read_npz(
    path: str | os.PathLike[str],
    *,
    kind: str,
    newest_version: int,
    max_bytes: int = MAX_BYTES,
    error: type[GelformError] = DataError,
) -> tuple[dict[str, Array], dict[str, Any]]:
    """Read a file of `write_npz`: the arrays by name and the settings, after every check.

    The sizes that the file declares are checked before anything is read, against `max_bytes` for all members together;
    nothing is unpickled. The caller converts formats older than `newest_version`.

    error: the file is missing, no file of this kind, truncated, altered, too large, or of a newer format (the message names
    the version of gelform to install).
    """
    path = check_path(path)
    if not path.is_file():
        raise error(f"No file {path}: expected a {kind}.")
    try:
        with cannot(f"read {path}", error=error):
            with path.open("rb") as file:
                is_picture = file.read(4).startswith(PICTURE_STARTS)
            with zipfile.ZipFile(path) as archive:
                if "meta.npy" not in names_in(archive, path, f"a {kind}", max_bytes, error):
                    raise error(f"{path} is no {kind}: it has no member 'meta'.")
                # Not by name: where a name stands often, that reads the last member each time, far more than is declared.
                members = [(one.filename.removesuffix(".npy"), one) for one in archive.infolist()]
                arrays = {name: _array(archive.read(one)) for name, one in members}
        meta = json.loads(str(arrays.pop("meta")[()]))
        _json(meta)
    except _UNREADABLE as problem:
        if is_picture:
            raise error(
                f"Expected a {kind}, got the picture {path}. gelform.read_image(path) reads pictures."
            ) from problem
        if path.suffix != ".npz" and (way := way_for(path)):
            raise error(f"Expected a {kind}, got {path}.{way}") from problem
        raise error(
            f"{path} is truncated or damaged, or no {kind} at all ({said(problem)}). "
            "Copy it again from where it was made, or make it anew."
        ) from problem
    _check_meta(meta, path, kind, newest_version, error)
    if meta.pop("digest") != digest_of(arrays, meta):
        raise error(
            f"{path} was altered after it was written: its digest does not agree with what it holds. "
            "Copy it again from where it was made, or make it anew."
        )
    return arrays, meta


def read_npy(path: str | os.PathLike[str], what: str) -> Array:
    """The array of a `.npy` file; `what` describes it in errors; nothing is unpickled.

    DataError: the file is missing, larger than 256 MB, damaged, an archive, or holds no numbers.
    """
    content = bytes_of(path, f"{what} (.npy)", MAX_ARRAY_BYTES)
    if content.startswith(b"PK"):
        raise DataError(f"Expected one array (.npy) in {path}, got an archive. Save {what} alone.")
    refuse_pickled(path, content)
    try:
        return _array(content)
    except ValueError as problem:
        raise DataError(
            f"{path} is no array file (.npy) of numbers, or a damaged one: {said(problem)}."
        ) from problem


def refuse_pickled(path: str | os.PathLike[str], content: bytes) -> None:
    """DataError, with what converts it, if a `.npy` file begins as one of Python objects, or as a pickle under that name."""
    if content.startswith(b"\x80"):  # the opcode PROTO, from protocol 2 on
        raise DataError(f"{path} is no array. {_PICKLE}")
    header = content[:256]
    if header.startswith(np.lib.format.MAGIC_PREFIX) and b"'|O'" in header:
        member = '.item()["NAME"]' if b"'shape': ()" in header else ""  # saved from a dict
        raise DataError(
            f"{path} holds pickled Python objects. Reading them can run code, so gelform does not. If you trust it, save "
            f'its numbers: numpy.save("frames.npy", numpy.stack(numpy.load("{PurePath(path).name}", '
            f"allow_pickle=True){member}))."
        )


def checked_archive(path: str | os.PathLike[str], what: str, max_bytes: int = MAX_ARRAY_BYTES) -> list[str]:
    """The names of an archive's members, which declare at most `max_bytes` together; nothing is read yet.

    DataError: the file is missing, too large, or declares more. The errors of zipfile: it is no archive.
    """
    with zipfile.ZipFile(present_file(path, what, max_bytes)) as archive:
        return names_in(archive, path, what, max_bytes)


def names_in(
    archive: zipfile.ZipFile,
    path: str | os.PathLike[str],
    what: str,
    max_bytes: int,
    error: type[GelformError] = DataError,
) -> list[str]:
    """As `checked_archive`, of an open one."""
    if (declared := sum(member.file_size for member in archive.infolist())) > max_bytes:
        raise error(
            f"{path} declares {declared / 1e6:.4g} MB; {what} has at most {max_bytes / 1e6:.4g} MB. It is damaged, or "
            "another file."
        )
    return archive.namelist()


@contextmanager
def damaged(
    path: str | os.PathLike[str], what: str, remedy: str, error: type[GelformError]
) -> Iterator[None]:
    """Raise the error for a file whose content, read inside, does not make `what`; words of gelform are quoted."""
    try:
        yield
    except KeyError as problem:
        raise error(f"{path} is damaged: {problem} is missing. {remedy}") from problem
    except (AttributeError, IndexError, OverflowError, TypeError, ValueError) as problem:
        found = (
            str(problem) if str(problem).startswith("Expected") else f"what it holds does not make {what}."
        )
        raise error(f"{path} is damaged: {found} {remedy}") from problem


def kind_of_npz(path: str | os.PathLike[str]) -> str | None:
    """The kind that a file names (its `format`), or None if it is no such file; nothing else is read."""
    if not check_path(path).is_file():  # opening a pipe would wait forever
        return None
    try:
        with zipfile.ZipFile(path) as archive:
            if archive.getinfo("meta.npy").file_size > MAX_META_BYTES:
                return None
            meta = json.loads(str(_array(archive.read("meta.npy"))[()]))
    except (OSError, *_UNREADABLE):
        return None
    kind = meta.get("format") if isinstance(meta, dict) else None
    return kind if isinstance(kind, str) else None


def digest_of(arrays: Mapping[str, Array], meta: Mapping[str, Any]) -> str:
    """SHA-256 (hex) over JSON-able settings and named arrays: names, dtypes, shapes and bytes."""
    sha = hashlib.sha256(_json(meta).encode())
    for name in sorted(arrays):
        values = np.ascontiguousarray(arrays[name])
        sha.update(f"\n{name} {arrays[name].dtype.str} {arrays[name].shape}\n".encode())
        sha.update(values.tobytes())
    return sha.hexdigest()


def _write_members(handle: BinaryIO, members: Mapping[str, Array]) -> None:
    """Write as `numpy.savez` does, but close the file properly if the disk is full."""
    with zipfile.ZipFile(handle, "w") as archive:
        for name, array in members.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)


_READ_HEADER = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def _array(content: bytes) -> Array:
    """One `.npy` member; its header is compared with its size before anything is allocated."""
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        shape, fortran_order, dtype = _READ_HEADER[version](stream)
    except Exception as problem:  # a damaged header fails in numpy's tokenizer in a dozen ways
        raise ValueError(f"an unreadable array header: {said(problem)}") from problem
    body = content[stream.tell() :]
    if dtype.hasobject:
        raise ValueError("an array of pickled objects")
    if dtype.itemsize * int(np.prod(shape, dtype=object)) != len(body):
        raise ValueError(f"an array of shape {shape} in {len(body)} bytes")
    return np.frombuffer(body, dtype=dtype).reshape(shape, order="F" if fortran_order else "C").copy()


def _check_meta(meta: Any, path: Path, kind: str, newest_version: int, error: type[GelformError]) -> None:
    if not isinstance(meta, dict) or not {"format", "format_version", "digest"} <= meta.keys():
        raise error(f"{path} is no {kind}: its member 'meta' names no format, version and digest.")
    if meta["format"] != kind:
        raise error(f"Expected a {kind}, got a {meta['format']}: {path}.")
    version = meta["format_version"]
    if not isinstance(version, int) or version < 1:
        raise error(f"{path} is damaged: format version {version!r}.")
    if version > newest_version:
        writer = meta.get("gelform_version", "of a newer release")
        raise error(
            f"{path} has format version {version}, written by gelform {writer}; this gelform reads up to "
            f"version {newest_version}. Install that release or a newer one: pip install 'gelform>={writer}'."
        )


def _json(meta: Mapping[str, Any]) -> str:
    try:
        return json.dumps(meta, sort_keys=True, allow_nan=False)
    except ValueError as problem:
        raise ValueError(
            "expected finite numbers in the settings, as JSON has them, got NaN or infinity"
        ) from problem


# Settings of PNG for OpenCV: level 1, with runs and Huffman codes only, because noise leaves no repetitions to find. A fifth
# smaller than without, and written as fast. With the filter AVG alone (OpenCV 5): twice as fast, at most an eighth larger.
FAST_PNG = (16, 1, 17, 3)
LIVE_PNG = (*FAST_PNG, 19, 64)


def picture_bytes(pixels: Array, ending: str = ".png", settings: Sequence[int] = ()) -> bytes:
    """The bytes of a picture file of an RGB image (H, W, 3) or a map (H, W).

    `ending` names the format; `settings` are OpenCV's.

    DataError: the format cannot hold the picture.
    """
    import cv2  # the help reads files without it

    shown = pixels[..., ::-1] if pixels.ndim == 3 else pixels
    try:
        done, content = cv2.imencode(ending, np.ascontiguousarray(shown), settings)
    except cv2.error:
        done = False
    if not done:
        size = f"{pixels.shape[0]}x{pixels.shape[1]}"
        raise DataError(f"OpenCV cannot encode a picture of {size} px as {ending[1:].upper()}.")
    return bytes(content.tobytes())


def shown_in_notebook(what: str, picture: bytes, rows: Iterable[tuple[str, str]]) -> str:
    """HTML of a picture, the bytes of a PNG, beside a table of (name, text); it fetches nothing from outside."""
    import html  # importing its table of characters takes longer than a frame

    shown = base64.b64encode(picture).decode("ascii")
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in rows
    )
    return (
        "<div style='display:flex;gap:1em;align-items:flex-start'>"
        f"<img alt='{html.escape(what)}' src='data:image/png;base64,{shown}'/><table>{cells}</table></div>"
    )

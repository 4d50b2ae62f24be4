"""Compile native/ into src/gelform/_native, as part of building a wheel or an editable installation, or by itself.

`python hatch_build.py` rebuilds a checkout. `CC` names another compiler and its flags (`CC="cc -g -O0"`); `GELFORM_TARGET`
another platform (`aarch64-linux-gnu.2.17`), cross-compiled by zig. See docs/native.md.
"""

from __future__ import annotations

import os
import platform
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).resolve().parent
ZIG = "ziglang==0.17.1"  # one version: everyone gets the same bits
ZIG_RUNS_ON = {  # what its package has wheels for
    "linux": {"x86_64", "i686", "aarch64", "armv7l", "ppc64le", "s390x", "riscv64"},
    "darwin": {"x86_64", "arm64"},
    "win32": {"amd64", "arm64", "x86"},
}
FLAGS = (
    "-std=c11 -O3 -g0 -Wall -Wextra -fPIC -shared -fvisibility=hidden"
    " -ffp-contract=off -fno-math-errno -fno-trapping-math"
)
AVX512 = "-mavx512f -mavx512cd -mavx512bw -mavx512dq -mavx512vl -mprefer-vector-width=512"
FLAGS_OF = {  # for each instruction set, the same sources
    "base": "",
    "v3": "-mavx2 -mfma",
    "v4": f"-mavx2 -mfma {AVX512}",
}
TAGS = {  # of wheels for other platforms, by zig's name of the target
    "x86_64-linux-gnu.2.17": "manylinux_2_17_x86_64.manylinux2014_x86_64",
    "aarch64-linux-gnu.2.17": "manylinux_2_17_aarch64.manylinux2014_aarch64",
    "x86_64-macos.11.0": "macosx_11_0_x86_64",
    "aarch64-macos.11.0": "macosx_11_0_arm64",
    "x86_64-windows-gnu": "win_amd64",
}


def compile_kernels(
    folder: Path = ROOT / "src/gelform/_native", native: Path = ROOT / "native", isas: Iterable[str] = ()
) -> list[Path]:
    """Compile every file of native/ into one library for each instruction set, side by side; their paths."""
    target = os.environ.get("GELFORM_TARGET", "")
    machine, system = (target or f"{platform.machine()}-{sys.platform}").lower().split("-")[:2]
    suffix = ".dll" if system.startswith("win") else ".so"
    sources = sorted(str(path) for path in native.rglob("*.c"))
    isas = list(isas) or (list(FLAGS_OF) if machine in ("x86_64", "amd64") else ["base"])
    built = [folder / f"kernels_{isa}{suffix}" for isa in isas]
    count = runpy.run_path(str(ROOT / "src/gelform/_native/sources.py"))
    of_sources, of_version = (
        count["digest_of_sources"](ROOT / "native"),
        count["digest_of_version"](version()),
    )

    def compile_one(isa: str, library: Path) -> None:
        own = shlex.split(os.environ.get("CC", ""))[1:]
        made_from = [f"-DSOURCES_DIGEST={of_sources}u", f"-DVERSION_DIGEST={of_version}u"]
        flags = [*FLAGS.split(), *FLAGS_OF[isa].split(), *made_from, *own]
        # A running process may have the old library open: written beside it, then moved. What else the compiler writes for
        # Windows, symbols for a debugger and an import library, goes with the folder.
        with tempfile.TemporaryDirectory(dir=folder) as beside:
            # Named without its folder, whose path a library of macOS would hold.
            run([*compiler(target), *flags, "-o", library.name, *sources], Path(beside))
            (Path(beside) / library.name).replace(library)

    with ThreadPoolExecutor() as pool:
        list(pool.map(compile_one, isas, built))
    return built


def version() -> str:
    """The one place of the version, which pyproject.toml reads too."""
    found = re.search(r'^__version__ = "(.+)"$', (ROOT / "src/gelform/__init__.py").read_text("utf-8"), re.M)
    if found is None:
        raise SystemExit('Expected a line __version__ = "..." in src/gelform/__init__.py.')
    return found[1]


def compiler(target: str) -> list[str]:
    """The command that compiles C: CC where it is set, else zig."""
    if "CC" in os.environ:
        if target:
            raise SystemExit("GELFORM_TARGET is compiled by zig alone: unset CC.")
        return shlex.split(os.environ["CC"])[:1]
    if find_spec("ziglang") is None:
        raise SystemExit(
            f'gelform compiles its C kernels: run pip install "{ZIG}", or set CC to a C compiler.'
        )
    where = ["-target", target] if target else []
    return [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        *where,
        "-mcpu=baseline",  # without it zig builds for this CPU alone
        "-s",  # symbols that no caller needs are half of a Windows library
    ]


def run(command: list[str], folder: Path) -> None:
    """Run a compiler in a folder; where it fails, its own words are the message."""
    if not shutil.which(command[0]):
        raise SystemExit(f'No compiler "{command[0]}" on PATH: install it, or unset CC to compile with zig.')
    with tempfile.TemporaryDirectory() as cache:
        home = os.name == "nt" or os.access(os.environ.get("HOME", ""), os.W_OK)  # zig keeps its cache there
        environment = os.environ if home else {"ZIG_GLOBAL_CACHE_DIR": cache, **os.environ}
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{shlex.join(command)}\n{done.stderr}\nThe C kernels do not compile.")


class KernelHook(BuildHookInterface):
    """Hatchling calls this for wheels, editable ones included."""

    def dependencies(self) -> list[str]:
        """What pip installs for the time of the build; a sentence where there is no such package."""
        if "CC" in os.environ:
            return []
        if platform.machine().lower() not in ZIG_RUNS_ON.get(sys.platform, ()):
            here = f"{sys.platform} {platform.machine()}"
            raise SystemExit(
                f"gelform compiles its C kernels, and zig has no package for {here}: set CC to a C compiler, such as CC=cc."
            )
        return [ZIG]

    def initialize(self, version: str, build_data: dict) -> None:
        """Compile, and name the wheel: one for each platform, for all Pythons."""
        if self.target_name != "wheel":
            return
        build_data["artifacts"] += [str(path.relative_to(ROOT)) for path in compile_kernels()]
        target = os.environ.get("GELFORM_TARGET")
        if target and target not in TAGS:
            raise SystemExit(f"Expected GELFORM_TARGET to be one of {', '.join(TAGS)}, got {target}.")
        tag = TAGS[target] if target else sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data |= {"pure_python": False, "tag": f"py3-none-{tag}"}


if __name__ == "__main__":
    compile_kernels()

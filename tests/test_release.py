"""`.ci/release`: what it refuses, and what it leaves where a step fails. All of it takes minutes and a network."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
pytestmark = [
    pytest.mark.skipif(not (ROOT / ".ci/release").exists(), reason="the source distribution has no .ci"),
    pytest.mark.skipif(sys.platform == "win32" or not shutil.which("git"), reason="needs bash and git"),
]


def git(clone, *words):
    return subprocess.run(["git", *words], cwd=clone, check=True, capture_output=True, text=True).stdout


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """What the script reads, checked in."""
    for who in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{who}_NAME", "nobody")
        monkeypatch.setenv(f"GIT_{who}_EMAIL", "nobody@example.org")
    for name in (".ci/release", "CITATION.cff", "src/gelform/__init__.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    news = "- News.\n" * 30_000  # more than a pipe holds
    (tmp_path / "CHANGELOG.md").write_text(f"# Changes\n\n## Unreleased\n\n{news}\n## 0.1.0\n\n- Old.\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "All")
    return tmp_path


def released(clone, *words):
    """Exit status and last line."""
    done = subprocess.run([".ci/release", *words], cwd=clone, capture_output=True, text=True)
    return done.returncode, done.stdout.strip().splitlines()[-1]


@pytest.mark.parametrize("version", [(), ("",), ("v0.2.0",), ("0.2",), ("0.2.0.dev0",), ("0.2.0; ls",)])
def test_what_is_no_version(clone, version):
    expected = f'Expected a version such as 0.1.0, got "{"".join(version)}".'
    assert released(clone, *version) == (1, expected)


def test_a_clone_that_is_not_clean(clone):
    (clone / "new.txt").write_text("mine")
    expected = "Expected a clean clone: commit or remove what git status shows."
    assert released(clone, "0.2.0") == (1, expected)


def test_a_version_that_was_released(clone):
    git(clone, "tag", "v0.2.0")
    assert released(clone, "0.2.0") == (1, "The tag v0.2.0 is there already: give another version.")


def test_nothing_to_say(clone):
    (clone / "CHANGELOG.md").write_text("# Changes\n\n## Unreleased\n\n## 0.1.0\n\n- Old.\n")
    git(clone, "commit", "-q", "-a", "-m", "No news")
    expected = 'Expected notes under "## Unreleased" in CHANGELOG.md: write what changes for users.'
    assert released(clone, "0.2.0") == (1, expected)


def test_a_release_that_fails_leaves_the_clone_as_it_was(clone, monkeypatch):
    """A python3 that fails stands where the build would begin, after the release is committed."""
    before = git(clone, "rev-parse", "HEAD")
    (clone / ".git/bin").mkdir()
    (clone / ".git/bin/python3").write_text("#!/bin/sh\ngit log -1 --format=%s > .git/reached\nexit 7\n")
    (clone / ".git/bin/python3").chmod(0o755)
    monkeypatch.setenv("PATH", f"{clone / '.git/bin'}:{os.environ['PATH']}")
    assert released(clone, "0.2.0") == (7, "nothing is released; the clone is as it was")
    assert (clone / ".git/reached").read_text() == "Release 0.2.0\n"
    assert git(clone, "rev-parse", "HEAD") == before
    assert git(clone, "status", "--porcelain") + git(clone, "tag") == ""

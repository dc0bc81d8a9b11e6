"""The installed package: its program, its licences, and conflicts with the other package named meniscus."""

from __future__ import annotations

import importlib.metadata
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

import meniscus

ROOT = Path(__file__).resolve().parents[4]
BINDINGS = Path(__file__).resolve().parents[1]
#: `python -m meniscus` and both scripts.
PROGRAMS = [[sys.executable, "-m", "meniscus"], *([str(Path(sysconfig.get_path("scripts")) / name)] for name in ("meniscus", "meniscus-surface"))]


def run(*command: object, path: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Runs a command. `path` is a folder of packages, which Python searches before all others."""
    environment = {"PYTHONPATH": str(path)} if path else {}
    return subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, env=environment)


@pytest.mark.parametrize("program", PROGRAMS, ids=["module", "meniscus", "meniscus-surface"])
def test_the_wheel_installs_the_program(program: list[str], dambreak: Path, tmp_path: Path) -> None:
    assert run(*program, "--version").stdout == f"meniscus {meniscus.__version__}\n"
    done = run(*program, "info", dambreak / "ParticleData_Fluid_20.bgeo")
    assert done.returncode == 0 and "particles" in done.stdout, done.stderr
    (tmp_path / "broken.ply").write_text("ply\n")
    assert run(*program, "check", tmp_path / "broken.ply").returncode == 3
    assert run(*program, "check").returncode == 2


def test_the_wheels_program_writes_the_same_bytes_as_the_program(program: object, dambreak: Path, tmp_path: Path) -> None:
    assert callable(program)
    for name, command in [("ours.ply", lambda *words: run(*PROGRAMS[0], *words)), ("same.ply", program)]:
        command("reconstruct", dambreak / "ParticleData_Fluid_1.bgeo", "-o", tmp_path / name, "--cell=1")
    assert (tmp_path / "ours.ply").read_bytes() == (tmp_path / "same.ply").read_bytes()


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A copy of the installed package in a separate folder."""
    shutil.copytree(Path(meniscus.__file__).parent, tmp_path / "meniscus")
    return tmp_path


def test_the_package_alone_does_not_warn(site: Path) -> None:
    assert run(sys.executable, "-c", "import meniscus; print(meniscus.__file__)", path=site).stderr == ""


def test_the_other_package_in_the_same_folder_is_named_with_its_version(site: Path) -> None:
    (site / "meniscus-0.2.0.dist-info").mkdir()
    done = run(sys.executable, "-c", "import meniscus; meniscus.reconstruct", path=site)
    assert done.returncode == 0 and "meniscus 0.2.0" in done.stderr and "RuntimeWarning" in done.stderr, done.stderr


@pytest.mark.parametrize("other", ["__version__ = '0.2.0'\n", None], ids=["replaced", "removed"])
def test_replaced_or_removed_files_give_an_error_with_the_remedy(site: Path, other: str | None) -> None:
    package = site / "meniscus" / "__init__.py"
    package.unlink() if other is None else package.write_text(other)
    for command in [["-m", "meniscus", "--version"], ["-c", "import meniscus.compat.pysplashsurf"]]:
        # -S ignores the environment's packages, which include the installed copy of this package.
        done = run(sys.executable, "-S", *command, path=site)
        assert done.returncode != 0 and "pip uninstall meniscus meniscus-surface" in done.stderr, done.stderr


def test_the_wheel_contains_the_licences_of_the_library() -> None:
    files = importlib.metadata.files("meniscus-surface") or []
    for name in "LICENSE-APACHE", "LICENSE-MIT":
        text = (ROOT / name).read_text()
        assert (BINDINGS / "licenses" / name).read_text() == text
        assert [file.read_text() for file in files if file.name == name] == [text]

"""Types: the stubs match the module, and the examples match the stubs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import meniscus

HERE = Path(__file__).resolve().parent
BINDINGS = HERE.parent

pytest.importorskip("mypy")


def stubtest(*arguments: Any, **keywords: Any) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mypy.stubtest", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **keywords)


def test_the_stubs_match_the_module() -> None:
    done = stubtest("meniscus", "--mypy-config-file", BINDINGS / "pyproject.toml")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_stub_with_a_wrong_signature_is_detected(tmp_path: Path) -> None:
    package = Path(meniscus.__file__).parent
    stub = (package / "_meniscus.pyi").read_text()
    changed = re.sub(r"overwrite: bool = False, ", "", stub, count=1)
    assert changed != stub
    copy = tmp_path / "meniscus"
    copy.mkdir()
    (copy / "_meniscus.pyi").write_text(changed)
    (copy / "__init__.pyi").write_text("")
    done = stubtest("meniscus._meniscus", env={"MYPYPATH": str(tmp_path), "PATH": ""})
    assert done.returncode != 0, done.stdout + done.stderr
    assert "Mesh.write" in done.stdout and "overwrite" in done.stdout, done.stdout + done.stderr


def test_keywords_with_a_wrong_name_or_type_are_detected(tmp_path: Path) -> None:
    wrong = [
        'meniscus.reconstruct(points, spacng=1.0)',
        'meniscus.reconstruct(points, spacing="1")',
        'meniscus.reconstruct(points, format="csv")',
        'meniscus.Frame(points, up="x")',
        'meniscus.Frame(points).surface(spacing=1.0)',
        'meniscus.Frame.load("a.bgeo", attributes=1)',
        'meniscus.Simulation("in", "out", frames=3)',
        'meniscus.Simulation(velocity=points)',
    ]
    right = [
        'meniscus.reconstruct(points, spacing=1, iso="auto", origin=(0, 0, 0), threads=None)',
        'meniscus.Frame(points, device=0, memory="1GiB").surface(smooth=2.0)',
        'meniscus.Simulation("in", "out", frames=(1, 2), format="csv", attributes=["heat"])',
    ]
    script = tmp_path / "calls.py"
    head = ["import numpy as np", "", "import meniscus", "", "points = np.zeros((1, 3))"]
    script.write_text("\n".join(head + wrong + right) + "\n")
    command = [sys.executable, "-m", "mypy", "--strict", str(script)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = {int(line) for line in re.findall(r"calls\.py:(\d+): error", done.stdout)}
    first = len(head) + 1
    assert lines == set(range(first, first + len(wrong))), done.stdout + done.stderr


def test_examples_and_the_package_are_strictly_typed() -> None:
    for what in ["-p", "meniscus"], [str(path) for path in (BINDINGS / "examples").glob("*.py")]:
        command = [sys.executable, "-m", "mypy", "--config-file", str(BINDINGS / "pyproject.toml"), "--strict", *what]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr


def test_everything_is_documented() -> None:
    for name in meniscus.__all__:
        item = getattr(meniscus, name)
        if isinstance(item, str):
            continue
        assert item.__doc__, name
        public = [getattr(item, member) for member in vars(item) if not member.startswith("_")] if isinstance(item, type) else []
        if item.__module__ == "meniscus" and not issubclass(item if isinstance(item, type) else int, BaseException):
            undocumented = [member for member in public if callable(member) and not member.__doc__]
            assert not undocumented, (name, undocumented)

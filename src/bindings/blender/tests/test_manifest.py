"""The zip meets the requirements of Blender."""

from __future__ import annotations

import re
import tomllib
import zipfile
from pathlib import Path

import blender_zip
import pytest

WHEEL = "meniscus_surface-0.3.0-cp310-abi3-manylinux_2_28_x86_64.whl"
#: Tags that extensions.blender.org accepts:
#: https://docs.blender.org/manual/en/latest/advanced/extensions/
TAGS = set(
    "3D View,Add Curve,Add Mesh,Animation,Bake,Camera,Compositing,Development,Game Engine,Geometry Nodes,Grease Pencil,Import-Export,Lighting,"
    "Material,Modeling,Mesh,Node,Object,Paint,Physics,Pipeline,Render,Rigging,Scene,Sculpt,Sequencer,System,Text Editor,Tracking,User Interface,"
    "UV".split(",")
)
PERMISSIONS = {"files", "network", "clipboard", "camera", "microphone"}
LICENSES = {"SPDX:GPL-2.0-or-later", "SPDX:GPL-3.0-or-later", "SPDX:LGPL-3.0-or-later", "SPDX:MIT", "SPDX:BSD-3-Clause", "SPDX:Zlib"}


def manifest() -> str:
    return (blender_zip.SOURCE / "blender_manifest.toml").read_text()


def test_the_manifest_meets_the_rules_of_the_extensions_platform() -> None:
    read = tomllib.loads(manifest())
    assert read["schema_version"] == "1.0.0" and read["type"] == "add-on"
    assert read["id"].isidentifier() and not read["id"].startswith("_") and "__" not in read["id"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", read["version"])
    assert read["website"].startswith("https://")
    assert set(read["tags"]) <= TAGS and set(read["permissions"]) <= PERMISSIONS and set(read["license"]) <= LICENSES
    assert all(re.fullmatch(r"\d{4}(-\d{4})? \S.*", line) for line in read["copyright"])
    assert read["copyright"][0].split(" ", 1)[1] in (blender_zip.ROOT / "LICENSE-MIT").read_text()
    # Blender rejects texts of more than 64 characters, and texts that end with punctuation.
    for text in [read["tagline"], *read["permissions"].values()]:
        assert len(text) <= 64 and re.search(r"\w$|\)$", text), text


def test_the_extension_requests_all_permissions_that_it_needs() -> None:
    permissions = set(tomllib.loads(manifest())["permissions"])
    signs = {"network": r"\b(urllib|requests|socket|http\.client)\b", "clipboard": r"\.clipboard\b"}
    for path in blender_zip.SOURCE.rglob("*.py"):
        used = {name for name, sign in signs.items() if re.search(sign, path.read_text())}
        assert used <= permissions, path


def test_wheels_are_named_before_the_permissions() -> None:
    read = tomllib.loads(blender_zip.manifest_with(manifest(), WHEEL))
    assert read["wheels"] == [f"./wheels/{WHEEL}"] and read["platforms"] == ["linux-x64"]
    assert set(read["permissions"]) == {"files"}


def test_the_version_equals_the_librarys_version() -> None:
    cargo = tomllib.loads((blender_zip.ROOT / "Cargo.toml").read_text())
    assert tomllib.loads(manifest())["version"] == cargo["package"]["version"]


@pytest.mark.parametrize(
    ("tag", "platform"),
    [("macosx_11_0_arm64", "macos-arm64"), ("win_amd64", "windows-x64"), ("manylinux_2_17_aarch64.manylinux2014_aarch64", "linux-arm64")],
)
def test_platforms_have_blenders_names(tag: str, platform: str) -> None:
    assert blender_zip.platform_of(f"meniscus_surface-0.3.0-cp310-abi3-{tag}.whl") == platform


def test_an_unsupported_platform_is_an_error() -> None:
    with pytest.raises(SystemExit, match="linux_riscv64"):
        blender_zip.platform_of("meniscus_surface-0.3.0-cp310-abi3-linux_riscv64.whl")


def test_the_zip_contains_all_modules_and_is_reproducible(tmp_path: Path) -> None:
    wheel = tmp_path / WHEEL
    wheel.write_bytes(b"wheel")
    zipped = blender_zip.pack(wheel, tmp_path)
    first = zipped.read_bytes()
    assert blender_zip.pack(wheel, tmp_path).read_bytes() == first
    names = set(zipfile.ZipFile(zipped).namelist())
    assert {"blender_manifest.toml", "__init__.py", "README.md", "LICENSE", f"wheels/{WHEEL}"} <= names
    # Every module that the extension imports must be in the zip.
    for path in [name for name in names if name.endswith(".py")]:
        text = zipfile.ZipFile(zipped).read(path).decode()
        for module in re.findall(r"^from \.([\w.]+) import", text, re.M):
            found = Path(path).parent.joinpath(*module.split("."))
            assert f"{found.as_posix()}.py" in names, (path, module)

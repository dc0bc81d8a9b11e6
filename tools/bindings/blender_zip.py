"""Packs the Blender extension and a wheel into a zip that Blender installs.

usage: blender_zip.py WHEEL FOLDER
"""

from __future__ import annotations

import re
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BINDINGS = ROOT / "src" / "bindings" / "blender"
SOURCE = BINDINGS / "extension"
#: Maps the platform in a wheel's name, as a pattern, to Blender's name for this platform.
PLATFORMS = {
    r"(many|musl)?linux.*_x86_64": "linux-x64",
    r"(many|musl)?linux.*_aarch64": "linux-arm64",
    r"macosx.*_arm64": "macos-arm64",
    r"macosx.*_x86_64": "macos-x64",
    r"win_amd64": "windows-x64",
    r"win_arm64": "windows-arm64",
}


def platform_of(wheel: str) -> str:
    """Blender's name for the platform of a wheel."""
    tags = wheel.removesuffix(".whl").rsplit("-", 1)[1].split(".")
    for tag in tags:
        for pattern, platform in PLATFORMS.items():
            if re.fullmatch(pattern, tag):
                return platform
    raise SystemExit(f"{wheel}: Blender does not run on any of these platforms: {', '.join(tags)}")


def manifest_with(manifest: str, wheel: str) -> str:
    """Adds the name of a wheel to the text of a manifest.

    The line must precede the first TOML table, because later lines belong to a table.
    """
    named = f'wheels = ["./wheels/{wheel}"]\nplatforms = ["{platform_of(wheel)}"]\n\n'
    return manifest.replace("[permissions]", named + "[permissions]", 1)


def pack(wheel: Path, folder: Path) -> Path:
    """Writes the zip, and returns its path. Equal files give a zip with equal bytes."""
    manifest = (SOURCE / "blender_manifest.toml").read_text()
    version = re.search(r'^version = "(.*)"$', manifest, re.M)
    name = re.search(r'^id = "(.*)"$', manifest, re.M)
    if version is None or name is None:
        raise SystemExit("the manifest must have an id and a version")
    zipped = folder / f"{name[1]}-{version[1]}-{platform_of(wheel.name)}.zip"
    files = {"blender_manifest.toml": manifest_with(manifest, wheel.name).encode(), "LICENSE": (ROOT / "LICENSE-MIT").read_bytes(), "README.md": (BINDINGS / "README.md").read_bytes()}
    for path in sorted(SOURCE.rglob("*.py")):
        files[path.relative_to(SOURCE).as_posix()] = path.read_bytes()
    files[f"wheels/{wheel.name}"] = wheel.read_bytes()
    with zipfile.ZipFile(zipped, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in sorted(files.items()):
            entry = zipfile.ZipInfo(path)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, data)
    return zipped


if __name__ == "__main__":
    print(pack(Path(sys.argv[1]), Path(sys.argv[2])))

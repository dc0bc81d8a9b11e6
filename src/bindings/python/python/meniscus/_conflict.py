"""Detects the unrelated PyPI package that also installs a folder ``meniscus``, and says what to do."""

from __future__ import annotations

import sys
from pathlib import Path

_REMEDY = (
    "The packages meniscus-surface and meniscus on PyPI are different projects, and both install a folder named meniscus: "
    "one environment can hold only one of them. Run: pip uninstall meniscus meniscus-surface; pip install meniscus-surface"
)


def other_package() -> str | None:
    """Returns a message with advice if the other package is installed in the same folder, else None."""
    for found in Path(__file__).resolve().parents[1].glob("meniscus-*.dist-info"):
        version = found.name.removeprefix("meniscus-").removesuffix(".dist-info")
        return f"the package meniscus {version} is installed over meniscus-surface. {_REMEDY}"
    return None


def require_own_package() -> None:
    """Raises ``ImportError`` if another package has replaced or removed files of this package."""
    package = sys.modules["meniscus"]
    if not hasattr(package, "reconstruct"):
        where = getattr(package, "__file__", None) or list(package.__path__)
        raise ImportError(f"import meniscus loads {where}, not the package meniscus-surface. {_REMEDY}")

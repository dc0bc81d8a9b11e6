"""Every option of the program is a keyword, and every keyword is an option."""

from __future__ import annotations

import ast
import inspect
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import meniscus

# Options of the program that are not keywords of `reconstruct`, each with the reason.
FILE_OPTIONS = {
    "output": "Mesh.write() takes it",
    "overwrite": "Mesh.write() takes it, too",
    "preview": "Mesh.write() takes it; Simulation has it for a sheet of its frames",
    "format": "arrays have none; read_particles(), Frame.load() and Simulation have it",
    "start": "Simulation has it",
    "end": "Simulation has it",
    "step": "Simulation has it",
    "frames": "Simulation has it",
    "resume": "Simulation has it",
    "watch": "Simulation has it",
    "fps": "Simulation has it",
    "together": "Simulation has it; Frame.load() takes a list of files",
}
PROGRAM_OPTIONS = {
    "plan": "Simulation.plan() does this",
    "parts": "jobs on several machines make a mesh in parts from files, and call the program",
    "part": "for the same reason as parts",
    "merge": "for the same reason as parts",
    "dry_run": "it only prints",
    "stats": "Mesh.report has them",
    "quiet": "the module prints nothing",
    "verbose": "the module prints nothing",
    "help": "it only prints",
    "version": "meniscus.__version__ contains it",
}
SIMULATION = set(FILE_OPTIONS) - {"output"}
# Keywords that are not options: arrays besides the positions, and the progress callback.
MODULE_KEYWORDS = {"velocity", "attributes", "progress"}


def keywords(function: Any) -> set[str]:
    """The names of all keyword parameters of a function."""
    parameters = inspect.signature(function).parameters.values()
    return {parameter.name for parameter in parameters if parameter.kind is parameter.KEYWORD_ONLY}


STUB = ast.parse((Path(meniscus.__file__).parent / "_meniscus.pyi").read_text())
CLASSES = {node.name: node for node in STUB.body if isinstance(node, ast.ClassDef)}


def assigned(where: ast.Module | ast.ClassDef) -> list[ast.AnnAssign]:
    return [node for node in where.body if isinstance(node, ast.AnnAssign)]


ALIASES = {ast.unparse(node.target): node.value for node in assigned(STUB) if node.value}


def typed(name: str) -> dict[str, ast.expr]:
    """The keys of one of the stub's TypedDicts and of its bases, each with its type."""
    found: dict[str, ast.expr] = {}
    for base in CLASSES[name].bases:
        if ast.unparse(base) != "TypedDict":
            found |= typed(ast.unparse(base))
    own = {ast.unparse(item.target): item.annotation for item in assigned(CLASSES[name])}
    assert not set(found) & set(own), f"{name} repeats a key"
    return found | own


def stub_keywords(function: ast.FunctionDef) -> set[str]:
    """The names of all keyword parameters that the stub declares for a function."""
    own = {argument.arg for argument in function.args.kwonlyargs}
    others = function.args.kwarg
    if others is None or others.annotation is None:
        return own
    unpacked = ast.unparse(others.annotation).removeprefix("Unpack[").removesuffix("]")
    return own | set(typed(unpacked))


def in_stub(where: ast.Module | ast.ClassDef, name: str) -> ast.FunctionDef:
    functions = (node for node in where.body if isinstance(node, ast.FunctionDef))
    return next(node for node in functions if node.name == name)


def members(annotation: ast.expr) -> list[ast.expr]:
    """The members of a union type, or the type itself if it is not a union."""
    if isinstance(annotation, ast.BinOp):
        return members(annotation.left) + members(annotation.right)
    return [annotation]


# A value for each type of keyword in the stub, except for types that list the allowed words.
SAMPLES: dict[str, Any] = {
    "None": None,
    "bool": False,
    "int": 3,
    "float": 0.5,
    "str": "1",
    "_Path": ".",
    "_Point": [0.0, 0.0, 0.0],
    "_Box": [-9.0, None, -9.0, 9.0, None, 9.0],
    "tuple[int, int]": (1, 2),
    "Iterable[str]": ["heat"],
    "Iterable[_Path]": ["ball.obj", Path("box.obj")],
}


def words(member: ast.expr) -> list[str]:
    """The words of a Literal type or its alias; empty for other types."""
    member = ALIASES.get(ast.unparse(member), member)
    text = ast.unparse(member)
    return re.findall(r"'([^']*)'", text) if text.startswith("Literal") else []


@pytest.fixture(scope="module")
def options(program: Any) -> set[str]:
    text = program("reconstruct", "--help")
    found = re.findall(r"^\s+(?:-\w, )?--([a-z0-9-]+)", text, re.MULTILINE)
    return {name.replace("-", "_") for name in found}


def test_every_option_of_reconstruct_is_a_keyword(options: set[str]) -> None:
    assert len(options) > 40
    assert set(FILE_OPTIONS) | set(PROGRAM_OPTIONS) <= options, "FILE_OPTIONS or PROGRAM_OPTIONS contains a name that is not an option"
    wanted = options - set(FILE_OPTIONS) - set(PROGRAM_OPTIONS)
    for function in meniscus.reconstruct, meniscus.Frame:
        assert keywords(function) == wanted | MODULE_KEYWORDS


def test_every_option_of_simulations_is_a_keyword(options: set[str]) -> None:
    wanted = options - set(PROGRAM_OPTIONS) - {"output", "progress"}
    assert keywords(meniscus.Simulation) == wanted
    assert "output" in inspect.signature(meniscus.Simulation).parameters
    assert keywords(meniscus.Mesh.write) == {"overwrite", "preview"} <= options
    # The keyword `attributes` takes names of attributes, as the program's option --attributes does.
    assert "attributes" in wanted


def test_surface_and_load_have_the_expected_keywords(options: set[str]) -> None:
    of_surface = keywords(meniscus.Frame.surface) - {"progress"}
    assert {"smooth", "simplify", "normals"} <= of_surface <= options
    assert keywords(meniscus.Frame.load) == keywords(meniscus.Frame) - {"velocity"} | {"format"}


def test_the_stub_has_the_keywords_of_each_function() -> None:
    frame = CLASSES["Frame"]
    pairs = [
        (meniscus.reconstruct, in_stub(STUB, "reconstruct")),
        (meniscus.Frame, in_stub(frame, "__new__")),
        (meniscus.Frame.load, in_stub(frame, "load")),
        (meniscus.Frame.surface, in_stub(frame, "surface")),
        (meniscus.Frame.volume, in_stub(frame, "volume")),
        (meniscus.Simulation, in_stub(CLASSES["Simulation"], "__new__")),
    ]
    for function, stub in pairs:
        assert stub_keywords(stub) == keywords(function), function


@pytest.mark.parametrize("name", sorted(typed("_OfFrames")))
def test_every_type_in_the_stub_is_accepted(name: str, tmp_path: Any) -> None:
    """Passes each type that the stub allows to a simulation: its value may be rejected, but not its type."""
    inputs, output = tmp_path / "in_{}.bgeo", tmp_path / "out_{}.ply"
    known: list[str] = []
    for member in members(typed("_OfFrames")[name]):
        known += words(member)
        values = words(member) or [SAMPLES[ast.unparse(member)]]
        for value in values:
            try:
                meniscus.Simulation(inputs, output, **{name: value})
            except (meniscus.InputError, meniscus.FileError, meniscus.DeviceError) as error:
                assert not re.search(": must be .*, not | is not one of ", str(error)), (name, value)
    if known and known != ["auto"]:
        with pytest.raises(meniscus.InputError) as refused:
            meniscus.Simulation(**{name: "?"})
        assert str(refused.value).rpartition("not one of ")[2].split(", ") == known


@pytest.mark.parametrize("name", sorted(keywords(meniscus.reconstruct) - MODULE_KEYWORDS))
def test_an_invalid_value_gives_an_error_that_names_the_keyword(name: str, ball: Any) -> None:
    calls = [lambda value: meniscus.reconstruct(ball, **{name: value}), lambda value: meniscus.Simulation(**{name: value})]
    if name in keywords(meniscus.Frame.load):
        calls.append(lambda value: meniscus.Frame.load("none.mnf", **{name: value}))
    if name in keywords(meniscus.Frame.surface):
        frame = meniscus.Frame(ball)
        calls.append(lambda value: frame.surface(**{name: value}))
    for call in calls:
        with pytest.raises((TypeError, meniscus.InputError), match=f"^{name}: "):
            call(object())


@pytest.mark.parametrize("name", ["start", "end", "step", "frames", "watch", "fps", "together", "attributes", "format", "resume", "preview"])
def test_every_keyword_of_simulations_is_read(name: str, tmp_path: Any) -> None:
    with pytest.raises(TypeError, match=f"^{name}: "):
        meniscus.Simulation("in_{}.bgeo", tmp_path / "out_{}.ply", **{name: object()})


def test_an_unknown_keyword_is_a_type_error(ball: Any) -> None:
    calls: list[Any] = [meniscus.reconstruct, meniscus.Frame]
    for call in calls:
        with pytest.raises(TypeError, match="unexpected keyword argument 'spacng'"):
            call(ball, spacng=1.0)
    with pytest.raises(TypeError, match="unexpected keyword argument 'spacng'"):
        meniscus.Simulation(spacng=1.0)  # type: ignore[call-arg]


def test_none_means_the_default(ball: Any) -> None:
    nothing = dict.fromkeys(keywords(meniscus.reconstruct))
    mesh = meniscus.reconstruct(ball, **nothing)
    assert np.array_equal(mesh.triangles, meniscus.reconstruct(ball).triangles)


def test_the_version_equals_the_programs_version(program: Any) -> None:
    assert program("--version").split()[1] == meniscus.__version__

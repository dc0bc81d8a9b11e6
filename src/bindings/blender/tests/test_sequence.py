"""Files of a sequence and their timing."""

from __future__ import annotations

import os
import re
from pathlib import Path

import meniscus
import numpy as np
import pytest
from surfaces.sequence import EXTENSIONS, Listings, Timing, number_of, sequence_of, shown_at, stamp_of

FRAMES = [(2, Path("f_2.bgeo")), (3, Path("f_3.bgeo")), (6, Path("f_6.bgeo"))]


@pytest.mark.parametrize(
    ("name", "expected", "number"),
    [
        ("Part_0005.bi4", "Part_{}.bi4", 5),
        ("ParticleData_Fluid_20.bgeo", "ParticleData_Fluid_{}.bgeo", 20),
        ("run_2_frame_007.bgeo.gz", "run_2_frame_{}.bgeo.gz", 7),
        ("run_2_frame_007.bgeo.zst", "run_2_frame_{}.bgeo.zst", 7),
        ("12.mnf", "{}.mnf", 12),
        ("-12.mnf", "{}.mnf", -12),
        ("pool_-003.vtp", "pool_{}.vtp", -3),
        ("pool-3.h5", "pool-{}.h5", 3),
        ("2024-01-07.npy.xz", "2024-01-{}.npy.xz", 7),
        ("pool.vtp", "pool.vtp", None),
        ("sim.h5part#12", "sim.h5part#12", None),
        ("frame_{:04}.ply", "frame_{:04}.ply", None),
    ],
)
def test_the_frame_number_is_the_last_number_before_the_extension(name: str, expected: str, number: int | None) -> None:
    assert sequence_of(os.path.join("a1", name)) == os.path.join("a1", expected)
    if number is not None:
        assert number_of(os.path.join("a1", name)) == number


def test_every_file_that_the_library_reads_can_be_chosen() -> None:
    with pytest.raises(meniscus.InputError) as refused:
        meniscus.read_particles("water.abc")
    known = set(re.findall(r"\.\w+", str(refused.value).split("abc", 1)[1]))
    # The extension also offers packed frames and lists of frames, which are not particle files.
    assert set(EXTENSIONS) == known | {".mnf", ".pvd", ".series"}
    assert len(";".join(f"*{extension}" for extension in EXTENSIONS)) <= 255


def test_a_file_gives_its_sequence_as_the_library_lists_it(sequence: Path) -> None:
    inputs = sequence_of(str(sequence / "ball_003.npy"))
    assert [number for number, _ in Listings().frames(inputs)] == [2, 3, 6]


def test_a_folder_with_a_number_in_its_name_is_a_sequence(tmp_path: Path) -> None:
    (tmp_path / "run_3").mkdir()
    assert sequence_of(str(tmp_path / "run_3")) == str(tmp_path / "run_3")


def test_frames_are_shown_by_their_numbers() -> None:
    timing = Timing(start=1, first=2)
    shown = [shown_at(FRAMES, timing, frame) for frame in range(-2, 9)]
    assert [each.number for each in shown] == [2, 2, 2, 2, 3, 3, 3, 6, 6, 6, 6]
    # A gap is a missing file between other files. Frames before the first file or after the last
    # file are not gaps.
    assert [each.is_gap for each in shown] == [False, False, False, False, False, True, True, False, False, False, False]
    assert shown[5].wanted == 4 and shown[5].path == "f_3.bgeo"


def test_steps_can_skip_or_repeat_files() -> None:
    assert [Timing(1, 0, 5.0).number(frame) for frame in (1, 2, 3)] == [0, 5, 10]
    assert [Timing(1, 0, 0.5).number(frame) for frame in (0, 1, 2, 3, 4)] == [-1, 0, 0, 1, 1]
    # A user who types 0.3333333 means 1/3: three scene frames must advance by one file.
    assert [Timing(0, 0, 0.3333333).number(frame) for frame in (2, 3, 9)] == [0, 1, 3]


def test_a_listing_is_read_again_when_its_folder_has_changed(sequence: Path) -> None:
    listings = Listings()
    inputs = str(sequence / "ball_{}.npy")
    assert listings.frames(inputs) is listings.frames(inputs)
    np.save(sequence / "ball_007.npy", np.zeros((1, 3)))
    assert [number for number, _ in listings.frames(inputs)] == [2, 3, 6, 7]


def test_missing_files_give_the_librarys_error(tmp_path: Path) -> None:
    with pytest.raises(meniscus.Error, match="no file matches"):
        Listings().frames(str(tmp_path / "none_{}.bgeo"))
    with pytest.raises(meniscus.Error, match="nowhere"):
        Listings().frames(str(tmp_path / "nowhere" / "none_{}.bgeo"))
    assert stamp_of(str(tmp_path / "none")) is None


def test_the_stamp_of_a_step_is_that_of_its_file(sequence: Path) -> None:
    file = str(sequence / "ball_002.npy")
    assert stamp_of(file + "#3") == stamp_of(file) != stamp_of(str(sequence / "ball_003.npy"))

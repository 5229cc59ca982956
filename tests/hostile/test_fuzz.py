"""A few hundred of the cases of `make fuzz`, and that the fuzzer finds what is planted."""

from __future__ import annotations

from collections import Counter
from itertools import count
from pathlib import Path

import pytest

from clsco.errors import SceneError
from tests.hostile import fuzz
from tests.hostile.mutate import Case, make_case
from tests.hostile.pictures import damaged, samples
from tests.hostile.watch import faults_of, start_watching, watched

start_watching()


@pytest.mark.filterwarnings("error")
def test_random_changes_of_scenes(tmp_path: Path) -> None:
    tally = Counter[str]()
    failures = [
        f"case {number}: {line}"
        for number in range(300)
        for line in fuzz.outcome(make_case(5, number), tmp_path, number, tally)
    ]
    assert failures == []
    assert tally["cases"] == 300
    assert tally["refused"] > 100
    assert tally["valid"] > 20
    assert tally["planned"] > 2


def test_damaged_pictures(tmp_path: Path) -> None:
    tally = Counter[str]()
    for name, (suffix, content) in samples().items():
        assert fuzz.picture_outcome((name, suffix, content), tmp_path, tally) == []
    assert tally["valid"] >= len(samples())  # as an image, as depths, or as both
    assert [line for number in range(150) for line in fuzz.picture_outcome(damaged(2, number), tmp_path, tally)] == []
    assert tally["refused"] > 150


def test_cases_are_the_same_on_every_run() -> None:
    def recorded(seed: int) -> list[object]:
        return [(case.base, case.text, case.changed) for case in (make_case(seed, number) for number in range(40))]

    assert recorded(3) == recorded(3)
    assert recorded(3) != recorded(4)


class TestPlanted:
    """The fuzzer notices an error of another kind, a wrong key, a file that is written, and a hang."""

    @pytest.mark.parametrize(
        ("parse", "expected"),
        [
            (lambda _: 1 // 0, "ZeroDivisionError"),
            (lambda _: raise_error("scene: object[0].radius: must be greater than 0; got 0"), "but the messages name"),
            (lambda _: raise_error("scene: camera.f_number: must be greater than 0"), "no `where: key: rule; got"),
            (lambda _: raise_error("scene: camera.f_number: must be above 0; got 0", "written"), "written: open "),
            (lambda _: any(False for _ in count()), "TooLongError"),
        ],
    )
    def test_is_found(self, parse: object, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(fuzz, "parse_sweep", parse)
        monkeypatch.setattr("tests.hostile.watch.LONGEST_S", 0.05)
        case = Case("plane", mapping={"camera": {"f_number": 0}}, changed=("camera", "f_number"))
        assert any(expected in fault for fault in fuzz.outcome(case, tmp_path, 1, Counter()))

    def test_control_characters(self) -> None:
        error = SceneError("x")
        error.messages = ("scene: a: must be b; got \x1b[2J",)
        assert faults_of(error, "scene")

    def test_what_is_not_watched_is_not_seen(self, tmp_path: Path) -> None:
        with watched() as written:
            pass
        (tmp_path / "later").write_text("")
        assert written == []


def raise_error(message: str, file: str = "") -> None:
    """Raise the error of a scene, after a file is written."""
    if file:
        Path(file).write_text("")
    raise SceneError(message)

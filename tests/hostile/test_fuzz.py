"""A few hundred of the cases of `make fuzz`, and that the fuzzer finds what is planted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from clsco.errors import SceneError
from clsco.scene import faults
from tests.hostile import fuzz
from tests.hostile.mutate import Case, make_case
from tests.hostile.pictures import damaged, samples
from tests.hostile.watch import faults_of, start_watching, watched

start_watching()


@pytest.mark.filterwarnings("error")
def test_random_changes_of_scenes(tmp_path: Path) -> None:
    tally = dict.fromkeys(fuzz.TALLY, 0)
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
    tally = dict.fromkeys(fuzz.TALLY, 0)
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

    def outcome(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, parse: object) -> list[str]:
        monkeypatch.setattr(fuzz, "parse_sweep", parse)
        case = Case("plane", mapping={"camera": {"f_number": 0}}, changed=("camera", "f_number"))
        return fuzz.outcome(case, tmp_path, 1, dict.fromkeys(fuzz.TALLY, 0))

    def test_another_error(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (found,) = self.outcome(tmp_path, monkeypatch, lambda mapping: 1 // mapping["camera"]["f_number"])
        assert "ZeroDivisionError" in found

    @pytest.mark.parametrize("message", [
        "scene: object[0].radius: must be greater than 0; got 0", "scene: camera.f_number: must be greater than 0",
        "camera.f_number: must be greater than 0; got 0",
    ])  # fmt: skip
    def test_a_message_without_its_key_or_form(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, message: str
    ) -> None:
        def parse(mapping: object) -> None:
            raise SceneError(message)

        assert self.outcome(tmp_path, monkeypatch, parse)

    def test_a_written_file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def parse(mapping: object) -> None:
            (tmp_path / "written").write_text("")
            raise SceneError("scene: camera.f_number: must be greater than 0; got 0")

        (found,) = self.outcome(tmp_path, monkeypatch, parse)
        assert found.startswith("written: open ")

    def test_a_hang(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def parse(mapping: object) -> None:
            while True:
                pass

        monkeypatch.setattr("tests.hostile.watch.LONGEST_S", 0.05)
        (found,) = self.outcome(tmp_path, monkeypatch, parse)
        assert "TooLongError" in found

    def test_control_characters(self) -> None:
        error = SceneError("x")
        error.messages = ("scene: a: must be b; got \x1b[2J",)
        assert faults_of(error, "scene")
        assert faults.MAX_MESSAGES * 2000 < 2**20
        assert os.linesep not in str(SceneError("scene: a\nb"))

    def test_what_is_not_watched_is_not_seen(self, tmp_path: Path) -> None:
        with watched() as written:
            pass
        (tmp_path / "later").write_text("")
        assert written == []

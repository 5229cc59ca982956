"""Dry runs, and the example sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from clsco.cli.tables import print_dry_run
from clsco.data import dryrun
from clsco.data.distribution import load_distribution
from clsco.data.dryrun import dry_run
from clsco.errors import DeviceError, SceneError
from tests.data.distributions import SCENE, Load

SETS = sorted((Path(__file__).parents[2] / "examples" / "sets").glob("*.toml"))
TEXT = """
[vary.camera]
focus_distance = [{ uniform = [300, 340] }, { uniform = [380, 420] }]
[[vary.object]]
name = "ball"
count = { integers = [0, 2] }
shape = { choice = ["sphere", "disc"] }
radius = { log_uniform = [5, 20] }
center = { frustum = { depth = [250, 350] } }
rotation = { rotation = "uniform" }
"""


def without_device(monkeypatch: pytest.MonkeyPatch) -> None:
    def choose(name: object) -> None:
        raise DeviceError("no device here")

    monkeypatch.setattr("clsco.opencl.device.choose", choose)


def test_a_dry_run_says_what_a_set_will_be(
    load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    without_device(monkeypatch)
    monkeypatch.setattr(dryrun, "MOST_DRAWN", 20)
    text = SCENE.replace("[64, 48]", "[32, 24]") + TEXT
    distribution = load(text, "", splits="train=0.75,test=0.25")
    found = dry_run(distribution, 1, 5000, arrays=("color", "depth", "flow"), sheet_path=tmp_path / "s.png")
    by_name = {one.name: one for one in found.parameters}
    focus = by_name["camera.focus_distance.0"]
    assert 300 <= (focus.low or 0) < 305 < (focus.mean or 0) < 335 < (focus.high or 0) <= 340
    count = by_name["object.ball.count"]
    assert (count.low, count.high) == (0, 2)
    assert by_name["object.ball.shape"].note.startswith("disc: ")
    assert by_name["object.ball.rotation"].note.endswith(" values")
    assert found.splits == {"train": 0.75, "test": 0.25}
    assert found.attempts == found.looked_at == 20
    assert found.frames == 2  # two variants
    assert found.bytes == {}
    assert found.seconds is None
    assert not (tmp_path / "s.png").exists()
    names = [one.name for one in found.measures]
    assert names == ["depth Z, mm", "blur radius |R|, px", "flow, px", "share of valid pixels"]
    assert all((one.low or 0) <= (one.mean or 0) <= (one.high or 0) for one in found.measures)
    assert (found.measures[0].low or 0) > 100
    assert found.measures[2].high == 0.0  # nothing moves
    print_dry_run(found)
    printed = capsys.readouterr().out
    for part in ("Parameters of 20 samples", "object.ball.radius", "train", "blur radius |R|, px", "no device here"):
        assert part in printed
    assert dry_run(distribution, 1, 5000, arrays=("color",)).parameters == found.parameters


def test_samples_that_fail_are_listed(load: Load, monkeypatch: pytest.MonkeyPatch) -> None:
    without_device(monkeypatch)
    monkeypatch.setattr(dryrun, "MOST_DRAWN", 10)
    monkeypatch.setattr("clsco.data.distribution.MAX_ATTEMPTS", 2)
    rare = "[vary.camera]\nfocus_distance = { uniform = [200, 600] }\n[accept]\nmax_blur_px = 2\n"
    found = dry_run(load(rare), 1, 10, arrays=("color",))
    assert found.failed
    assert all("accept: must hold for one of 2 attempts" in message for message in found.failed)
    with pytest.raises(SceneError, match=r"max_blur_px must be at most 0\.001"):
        dry_run(load(rare.replace("= 2\n", "= 0.001\n")), 1, 3, arrays=("color",))


@pytest.mark.slow
def test_a_contact_sheet_shows_samples(load: Load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dryrun, "RENDER_S", np.inf)  # on a busy machine as well
    found = dry_run(load(TEXT), 1, 6, arrays=("color", "depth"), sheet_path=tmp_path / "sheet.png")
    assert found.sheet == tmp_path / "sheet.png"
    assert (found.seconds or 0) > 0
    assert found.bytes == {"color": 2 * 64 * 48 * 2.0, "depth": 2 * 64 * 48 * 4.0}
    sheet = np.asarray(Image.open(tmp_path / "sheet.png"))
    assert sheet.shape[1] > 4 * 2 * 64
    assert sheet.std() > 10


def test_example_sets_load() -> None:
    assert [path.stem for path in SETS] == ["blurred_video", "charts", "defocus_pairs", "focal_stacks", "stereo"]
    variants = {}
    for path in SETS:
        distribution = load_distribution(path, splits="train=0.9,test=0.1")
        variants[path.stem] = len(distribution.draw(2026, 3).scenes)
    assert variants == {"blurred_video": 1, "charts": 1, "defocus_pairs": 2, "focal_stacks": 9, "stereo": 1}

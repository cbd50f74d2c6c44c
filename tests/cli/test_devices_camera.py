"""`labrig devices camera`, on a rig whose camera shows pictures from a folder."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.cli.conftest import RIG, Labrig

SIZE = (720, 1280)
MakeRig = Callable[..., Path]


def _draw_paper(blur_px: float = 1.0) -> NDArray[np.uint8]:
    """Draw lines 16 px apart, slightly blurred."""
    paper = np.full(SIZE, 180.0, np.float32)
    for at in range(8, 1280, 16):
        paper[:, at : at + 2] = 90
        paper[at : at + 2] = 90
    noise = np.random.default_rng(1).normal(0.0, 1.5, SIZE)
    return np.clip(cv2.GaussianBlur(paper, (0, 0), blur_px) + noise, 0, 255).astype(np.uint8)


@pytest.fixture
def make_rig(tmp_path: Path) -> MakeRig:
    """Return what writes a simulated rig whose camera shows a picture again and again."""

    def make(image: NDArray[np.uint8], pictures: int = 9) -> Path:
        folder = tmp_path / "pictures"
        folder.mkdir()
        content = cv2.imencode(".png", image)[1].tobytes()
        for number in range(pictures):
            (folder / f"{number:06d}.png").write_bytes(content)
        text = RIG.read_text(encoding="utf-8")
        camera = "camera: {driver: files, source: pictures, width_px: 1280, height_px: 720, rate_hz: 30}\n\n"
        text = re.sub(r"^camera:\n(?:  .*\n|\n)*", camera, text, count=1, flags=re.MULTILINE)
        rig = tmp_path / "rig.yaml"
        rig.write_text(text, encoding="utf-8")
        return rig

    return make


def test_pictures_are_scored_and_the_last_is_saved_once(
    labrig: Labrig, make_rig: MakeRig, tmp_path: Path
) -> None:
    """One document has the scores of each picture; a file that exists is never replaced."""
    image, frame = _draw_paper(), tmp_path / "frame.png"
    command = ("devices", "camera", "--rig", make_rig(image, 16), "--save", frame)
    done = labrig(*command, "--json")
    document = done.json()
    assert (done.exit_code, document["ok"], len(document["pictures"])) == (0, True, 16)
    scores = {score["name"]: score for score in document["pictures"][-1]["scores"]}
    assert 2.0 < scores["focus"]["value"] < 6.0
    assert scores["flicker"]["value"] == 0.0
    assert document["pictures"][0]["scores"][-1]["value"] is None
    assert np.array_equal(cv2.imread(str(frame), cv2.IMREAD_UNCHANGED), image)
    kept = frame.read_bytes()
    again = labrig(*command)
    assert (again.exit_code, frame.read_bytes()) == (2, kept)
    assert "choose another name" in again.err


def test_a_blurred_picture_is_no_good(labrig: Labrig, make_rig: MakeRig) -> None:
    """The exit code is 1, and the table names value, limit and remedy."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]]
    disc = np.where(np.hypot(u - 320, v - 200) < 120, 170.0, 60.0).astype(np.float32)
    done = labrig(
        "devices", "camera", "--rig", make_rig(cv2.GaussianBlur(disc, (0, 0), 6).astype(np.uint8), 16)
    )
    assert done.exit_code == 1
    assert re.search(r"^FAIL  focus: edges are 1\d\.\d px wide \(at most 6 px\)$", done.out, re.MULTILINE)
    assert "change camera.focus in the rig file" in done.out


def test_the_page_shows_the_pictures_until_interrupted(make_rig: MakeRig) -> None:
    """A browser gets scores and picture by the address that was printed; Ctrl+C ends with 130."""
    rig = make_rig(_draw_paper(), pictures=1000)
    command = [sys.executable, "-m", "labrig", "devices", "camera", "--rig", str(rig), "--web"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env={**os.environ}
    ) as running:
        assert running.stderr is not None
        url = running.stderr.readline().removeprefix("open ").strip()
        state = {"number": -1}
        while state["number"] < 1:
            state = json.loads(urlopen(f"{url}state.json", timeout=30).read())
        jpeg = urlopen(f"{url}picture", timeout=30).read()
        assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED).shape == SIZE
        running.send_signal(signal.SIGINT)
        printed, _ = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "focus" in printed

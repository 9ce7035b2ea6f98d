"""The benchmarks measure, see what has become slower, and name who is not there."""

import io
import pathlib
import pickle
import sys
import time

import jax
import numpy as np
import pytest
from reference import raster as twin

import jaxraster as jr
from benchmarks import __main__ as runner
from benchmarks import batch, gate, peers, report, workloads
from benchmarks.measure import Row, measure
from benchmarks.peers.__main__ import serve
from benchmarks.peers.elsewhere import Elsewhere
from benchmarks.workloads import Workload

SIZE = 8
FAR_AND_NEAR = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
# A large triangle, and a smaller one before its right half; no edge comes near a pixel's centre.
POINTS = np.array(
    [[-1.9, -0.9, 0.2], [1.9, -0.9, 0.2], [0.1, 2.3, 0.3], [0.1, -0.4, 0.5], [0.9, -0.4, 0.6], [0.4, 0.8, 0.5]]
)
PARALLEL = np.concatenate([POINTS, np.ones((6, 1))], axis=1).astype(np.float32)
# The same picture in perspective: w is the distance from the eye, and z the near plane's.
W = 0.1 / POINTS[:, 2:]
PERSPECTIVE = np.concatenate([POINTS[:, :2] * W, np.full((6, 1), 0.1), W], axis=1).astype(np.float32)
ROW = Row("W1", SIZE, compile=900.0, steady=3.0, calibration=5.0, memory=1000, peers={}, differ=None)
SLEEP_MS = 20.0


def right(clip):
    """The face of every pixel, none of whose centres is within a twentieth of a pixel of an edge."""
    face, _, distance = twin.cast(clip, FAR_AND_NEAR, SIZE, SIZE)
    assert distance.min() > 0.05
    return face


class Slow:
    """A peer that takes its time and is wrong about one pixel."""

    name = "Slow 1.0"

    def __init__(self, clip, faces, size):
        self.clip = clip

    def draw(self):
        time.sleep(1e-3 * SLEEP_MS)

    def faces(self):
        return np.where(np.arange(SIZE**2).reshape(SIZE, SIZE) == 0, 77, right(self.clip))

    def release(self):
        self.clip = None


class Absent:
    """A peer whose package is missing."""

    def __init__(self, clip, faces, size):
        raise ImportError("no package absent\nand more about it")


def test_a_row_holds_times_memory_and_what_differs(capsys):
    row = measure("W0", Workload(PARALLEL, FAR_AND_NEAR), SIZE, {"Absent": Absent, "Slow": Slow}, runs=2)
    assert 0 < row.steady < row.compile < np.inf and 0 < row.calibration < np.inf
    assert row.memory > 0
    assert row.peers.keys() == {"Slow"} and row.peers["Slow"] >= SLEEP_MS
    assert row.differ == 1 / SIZE**2
    assert capsys.readouterr().out == "Absent does not draw W0 at 8 px: no package absent\n"


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({}, []),
        ({"steady": 4.4}, []),
        ({"steady": 4.6}, ["steady"]),
        ({"steady": 4.6, "calibration": 10.0}, []),
        ({"calibration": 1.6}, ["steady", "compile"]),
        ({"compile": 2600.0}, []),
        ({"compile": 2800.0}, ["compile"]),
        ({"memory": 1101}, ["memory"]),
        ({"memory": 1}, []),
        ({"size": 9}, ["not in baseline.json"]),
    ],
)
def test_the_gate_names_what_is_worse_than_it_was(change, named, tmp_path, monkeypatch):
    monkeypatch.setattr(gate, "BASELINE", tmp_path / "baseline.json")
    gate.write([ROW])
    lines = gate.offenders([ROW._replace(**change)])
    assert len(lines) == len(named)
    assert all(name in line and line.startswith("W1, ") for name, line in zip(named, lines))


def test_the_page_the_baseline_and_the_exit_code(tmp_path, monkeypatch, capsys):
    """`--write` replaces the table alone, and `--gate` holds the next run against it."""
    page, rows = tmp_path / "page.md", {"W1": ROW._replace(peers={"Slow": 6.0}, differ=0.25)}
    page.write_text(f"before\n{report.BEGIN}\nold\n{report.END}\nafter\n")
    monkeypatch.setattr(report, "PAGE", page)
    monkeypatch.setattr(gate, "BASELINE", tmp_path / "baseline.json")
    monkeypatch.setattr(workloads, "WORKLOADS", {"W1": lambda size: None})
    monkeypatch.setattr(peers, "PEERS", {"Absent": Absent, "Slow": Slow})
    monkeypatch.setattr(runner, "measure", lambda name, *_: rows[name])
    asked = ["--sizes", str(SIZE), "--runs", "1"]
    for _ in range(2):
        assert runner.main([*asked, "--write"]) == 0
    text = page.read_text()
    assert text.startswith(f"before\n{report.BEGIN}\n\n| workload ") and text.endswith(f"\n{report.END}\nafter\n")
    assert "old" not in text
    assert text.count("\n| W1 | 8 | 0.90 (180.00) | 3.00 (0.60) | 0.0 | 25.000 % | 6.00 (1.20) |\n") == 1
    assert "\n- Absent: absent: no package absent\n- Slow: Slow 1.0\n" in text
    assert "\n- geometric mean of time over ours: Slow 2.00 (1 rows)\n- calibration: 5.0 to 5.0 ms\n" in text
    assert "\n- `python -m benchmarks --write --sizes 8 --runs 1`\n" in text
    assert runner.main([*asked, "--gate"]) == 0
    rows["W1"] = rows["W1"]._replace(steady=30.0)
    capsys.readouterr()
    assert runner.main([*asked, "--gate"]) == 1
    assert capsys.readouterr().out.splitlines()[-1].startswith("W1, 8 px: steady is 6, was 0.6")


def test_what_cannot_be_asked_for_is_refused(capsys):
    for wrong in (["--helmet", "nowhere.gltf"], ["--sizes", "a"], ["--write", "--gate"]):
        with pytest.raises(SystemExit, match="2"):
            runner.main(wrong)
        assert wrong[0] in capsys.readouterr().err


@pytest.mark.parametrize("name", peers.PEERS)
@pytest.mark.parametrize("clip", [PARALLEL, PERSPECTIVE], ids=["parallel", "perspective"])
def test_a_peer_that_is_there_sees_the_same(name, clip):
    try:
        # One that is made of JAX too has rules of its own.
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            peer = peers.PEERS[name](clip, FAR_AND_NEAR, SIZE)
    except Exception as error:
        pytest.skip(f"{name} is absent: {error}")
    peer.draw()
    seen = peer.faces()
    peer.release()
    assert set(seen.flat) == {-1, 0, 1}
    np.testing.assert_array_equal(seen, right(clip))


def test_a_peer_of_another_process_answers_in_turn():
    questions = io.BytesIO(b"".join(map(pickle.dumps, [(PARALLEL, FAR_AND_NEAR, SIZE), "draw", "faces", "nothing"])))
    answers = io.BytesIO()
    serve(Slow, questions, answers)
    answers.seek(0)
    assert pickle.load(answers) == (True, "Slow 1.0")
    assert pickle.load(answers) == (True, None)
    assert pickle.load(answers)[1].shape == (SIZE, SIZE)
    assert pickle.load(answers) == (False, "'Slow' object has no attribute 'nothing'")
    with pytest.raises(RuntimeError, match="its process ended with code 1"):
        Elsewhere(pathlib.Path(sys.executable), "nobody", PARALLEL, FAR_AND_NEAR, SIZE)


def test_ways_to_draw_a_batch_agree():
    def corners(vertices, camera):
        return jr.project(vertices, camera, height=SIZE, width=SIZE)

    vertices, cameras = np.float32(POINTS), batch.cameras(4)
    once = batch.batched(corners)(vertices, cameras)
    assert once.shape == (4, 6, 4)
    np.testing.assert_allclose(batch.looped(corners)(vertices, cameras), once, rtol=1e-6)
    np.testing.assert_allclose(batch.sharded(corners, jax.devices()[:1])(vertices, cameras), once, rtol=1e-6)


def test_the_batch_has_visibility_and_frames():
    scene, camera = batch.scene(), jax.tree.map(lambda leaf: leaf[0], batch.cameras(2))
    assert scene.mesh.faces.shape[0] == 5122
    drawn = {name: jax.eval_shape(draw, scene, camera) for name, draw in batch.pictures(scene, SIZE).items()}
    assert drawn["visibility"].face.shape == (SIZE, SIZE)
    assert drawn["frame"].shape == (SIZE, SIZE, 3)

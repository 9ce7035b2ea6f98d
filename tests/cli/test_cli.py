"""The command line: one line and the right exit code for whatever goes wrong, and a picture when nothing does."""

import dataclasses
import os
import pathlib
import pty
import re
import signal
import subprocess
import sys
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from refused import check_refused

import jaxraster
from jaxraster.cli import compare, main, prepare, render
from jaxraster.cli.aov import AOVS
from jaxraster.errors import AssetWarning, Error
from jaxraster.io.environment import TOWARDS_SUN, TURBIDITY
from jaxraster.io.exr import read_exr
from jaxraster.io.image import read_image
from jaxraster.io.radiance import read_hdr
from jaxraster.io.reading import Limits
from jaxraster.screen.horizon import HorizonAO
from jaxraster.screen.ssao import SSAO

ROOT = pathlib.Path(__file__).parents[2]
STEPS = ("loading", "planning", "compiling", "rendering", "saving")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Run in a folder with a few broken scenes, and one that is almost whole."""
    (tmp_path / "empty.gltf").write_bytes(b"")
    (tmp_path / "cut.gltf").write_text('{"asset": {"version": "2.0"}, "meshes": [')
    (tmp_path / "cut.glb").write_bytes(b"glTF\2\0\0\0\xff\0\0\0")
    (tmp_path / "scene.xyz").write_text("?")
    (tmp_path / "triangle.obj").write_text("mtllib gone.mtl\nv -1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "broken.obj").write_text("v -1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 9\n")
    (tmp_path / "bright.mtl").write_text("newmtl lamp\nKd 3 3 3\n")
    (tmp_path / "bright.obj").write_text("mtllib bright.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl lamp\nf 1 2 3\n")
    (tmp_path / "linked.png").symlink_to("triangle.obj")
    (tmp_path / "linked.exr").symlink_to("triangle.obj")
    (tmp_path / "is_a_folder.png").mkdir()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(words: str) -> int:
    """The exit code of a command in this process."""
    return main(words.split())


REFUSED = [
    # words, exit code, what the line on stderr must say
    ("", 2, "no command given; choose one of: render"),
    ("rendr", 2, "'rendr'"),
    ("render a b", 2, "one argument too many: 'b'"),
    ("render --widht 64", 2, "unknown option '--widht'; did you mean '--width'?"),
    ("render --zzz", 2, "unknown option '--zzz'; known: --help, --debug, --output, --width"),
    ("render --wid 64", 2, "unknown option '--wid'; did you mean '--width'?"),
    ("render --width", 2, "--width: expected one argument"),
    ("render --width 0", 2, "--width: expected a whole number from 1 on, got '0'"),
    ("render --height -480", 2, "--height: expected a whole number from 1 on, got '-480'"),
    ("render --width 64.5", 2, "--width: expected a whole number from 1 on, got '64.5'"),
    ("render --width 16385", 5, "--width: 16385 pixels; at most 16384 are allowed (limit picture_side)"),
    ("render --width 16384 --height 16384 --supersample 2", 5, "1073741824 samples; at most 268435456 are"),
    ("render --supersample 9", 2, "--supersample: expected a whole number from 1 to 8, got '9'"),
    ("render --exposure nan", 2, "--exposure: expected a finite number, got 'nan'"),
    ("render --exposure -1e999", 2, "--exposure: expected a finite number, got '-1e999'"),
    ("render --light-direction 0,0,0", 2, "--light-direction: a direction needs a length above zero"),
    ("render --light-direction -1,-2", 2, "--light-direction: expected three finite numbers x,y,z, got '-1,-2'"),
    ("render --light-direction 1,inf,1", 2, "--light-direction: expected three finite numbers x,y,z, got '1,inf,1'"),
    ("render --tonemap pbr_netral", 2, "--tonemap: unknown name 'pbr_netral'; did you mean 'pbr_neutral'?"),
    ("render --tonemap ?", 2, "--tonemap: unknown name '?'; known: clip, reinhard"),
    ("render --shading phong", 2, "--shading: unknown name 'phong'; known: standard, gltf, local"),
    ("render --occlusion sao", 2, "--occlusion: unknown name 'sao'; did you mean 'ssao'?"),
    ("render --occlusion ?", 2, "--occlusion: unknown name '?'; known: auto, none, ssao, horizon"),
    ("render --occlusion-radius 0", 2, "--occlusion-radius: expected a number from 1e-06 to 1e+09, got '0'"),
    ("render --occlusion-radius -1", 2, "--occlusion-radius: expected a number from 1e-06 to 1e+09, got '-1'"),
    ("render --occlusion-radius inf", 2, "--occlusion-radius: expected a finite number, got 'inf'"),
    ("render --occlusion none --occlusion-radius 1", 2, "--occlusion-radius: is of what '--occlusion none' leaves out"),
    ("render --occlusion ssao --shading local", 2, "--occlusion: '--shading local' has no visibility of lights"),
    ("render --occlusion-radius 1 --shading local", 2, "--occlusion: '--shading local' has no visibility of lights"),
    ("render --aov depth,?", 2, "--aov: unknown name '?'; known: depth, normal"),
    ("render --camera 0", 2, "--camera: is for files; 'stage' is built in"),
    ("render stage --light-direction 1,-1,1", 2, "--light-direction: is for files"),
    ("render cornel_box", 3, "cornel_box: neither a file nor a built-in scene; did you mean 'cornell_box'?"),
    ("render missing.gltf", 3, "missing.gltf: cannot be read: No such file or directory"),
    ("render empty.gltf", 3, "empty.gltf: is empty"),
    ("render cut.gltf", 3, "cut.gltf: "),
    ("render cut.glb", 3, "cut.glb: "),
    ("render scene.xyz", 3, "scene.xyz: "),
    ("render is_a_folder.png", 3, "is_a_folder.png: "),
    ("render -o is_a_folder.png", 4, "is_a_folder.png: cannot be written: it is a folder"),
    ("render -o nowhere/x.png", 4, "nowhere/x.png: cannot be written: there is no folder"),
    ("render -o picture", 4, "picture: no suffix"),
    ("render -o picture.tiff", 4, "picture.tiff: unknown picture format '.tiff'"),
    ("render -o /dev/null/x.png", 4, "/dev/null/x.png: cannot be written"),
    ("render -o", 2, "-o/--output: expected one argument"),
    ("render -o nowhere/x.exr", 4, "nowhere/x.exr: cannot be written: there is no folder"),
    ("render --exr nowhere/x.exr", 4, "nowhere/x.exr: cannot be written: there is no folder"),
    ("render --exr x.png", 4, "x.png: --exr writes OpenEXR; end the name with .exr"),
    ("render -o x.exr --exr ./x.exr", 4, "x.exr: would hold the picture and --exr both"),
    ("render stage --strict", 2, "--strict: is for files; 'stage' is built in"),
    ("render --limit triangle=5", 2, "--limit: unknown name 'triangle'; did you mean 'triangles'?"),
    ("render --limit triangles=0", 2, "--limit: expected a whole number from 1 on, got '0'"),
    ("render --limit triangles", 2, "--limit: expected a whole number from 1 on, got ''"),
    ("render --width 9 --limit picture_side=8", 5, "--width: 9 pixels; at most 8 are allowed (limit picture_side)"),
    ("render triangle.obj --limit file_bytes=9", 5, "triangle.obj: has 49 bytes; at most 9 are allowed"),
    ("render --repair --strict", 2, "--strict: not allowed with argument --repair"),
    ("render broken.obj", 3, "broken.obj: line 5: "),
    ("render bright.obj --strict", 3, "which strict forbids"),
    ("render triangle.obj -o linked.png", 4, "linked.png: is the scene itself"),
    ("render triangle.obj --exr linked.exr", 4, "linked.exr: is the scene itself"),
    ("limits stage", 2, "one argument too many: 'stage'"),
]


@pytest.mark.parametrize(("words", "code", "says"), REFUSED, ids=[words or "nothing" for words, *_ in REFUSED])
def test_refusals(words, code, says, capsys, folder):
    check_refused(run, words, code, says, capsys, folder)


def test_words_that_must_parse(monkeypatch):
    """Negative numbers are values, and names may be repeated."""
    seen = []
    monkeypatch.setattr(render, "run", seen.append)
    words = "render a.glb --light-direction -1,-2,-.5 --exposure -1e-3 -o x.png --aov uv,depth,uv --camera 3"
    assert run(words) == 0
    (arguments,) = seen
    assert arguments.light_direction == (-1.0, -2.0, -0.5)
    assert (arguments.scene, arguments.exposure, arguments.output) == ("a.glb", -1e-3, "x.png")
    assert (arguments.aov, arguments.camera) == (["uv", "depth"], 3)


def test_the_readmes_commands(monkeypatch, capsys):
    """Every command that the README shows passes the checks that come before loading."""
    for command in (compare, render):
        monkeypatch.setattr(command, "run", command._check)
    monkeypatch.setattr(prepare, "run", lambda arguments: None)  # it has nothing to check but the file
    lines = [line.split("#")[0] for line in (ROOT / "README.md").read_text().splitlines()]
    commands = [line.removeprefix("jaxraster ") for line in lines if line.startswith("jaxraster ")]
    assert len(commands) >= 5
    assert [(words, capsys.readouterr().err) for words in commands if run(words) != 0] == []


def test_help_and_version(capsys):
    """The help names what the program knows, and costs no rendering."""
    from jaxraster.scenes import SCENES

    assert main(["render", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert all(name in text for name in SCENES)
    numbers = HorizonAO().radius, SSAO().radius, TURBIDITY
    defaults = [*(f"{number:g}" for number in numbers), ",".join(map(str, TOWARDS_SUN))]
    assert [value for value in defaults if f"(default: {value})" not in text] == []
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("jaxraster ")


FAULTS = [
    # what happens inside, exit code, what stderr says
    (KeyboardInterrupt(), 130, ""),
    (TypeError("two\nlines"), 1, "jaxraster: internal error: TypeError: two lines; please report it"),
    (RuntimeError("RESOURCE_EXHAUSTED: Out of memory"), 5, "jaxraster: error: out of memory; choose a smaller"),
    (MemoryError(), 5, "jaxraster: error: out of memory; choose a smaller"),
]


@pytest.mark.parametrize(("fault", "code", "says"), FAULTS, ids=lambda value: type(value).__name__)
def test_faults_inside(fault, code, says, capsys, monkeypatch, folder):
    """What goes wrong in a stage is one line too; a traceback is for --debug; an old picture stays."""

    def fail(*_, **__):
        raise fault

    monkeypatch.setattr(jaxraster.scenes, "SCENES", {"stage": fail})
    (folder / "render.png").write_bytes(b"old")
    for words in (["render"], ["render", "--debug"]):
        assert main(words) == code
        err = capsys.readouterr().err
        assert says in err
        assert ("Traceback" in err) == (words[-1] == "--debug" and code != 130)
        assert "Traceback" in err or err.count("\n") == (code != 130)
    assert (folder / "render.png").read_bytes() == b"old"
    assert [path.name for path in folder.iterdir() if path.suffix == ".tmp"] == []


def small_frame(scene, camera, plan):
    """Stands in for `render`: a grey picture with one broken pixel."""
    image = jnp.full((plan.height, plan.width, 3), 0.5).at[1, 2].set(jnp.nan)
    empty = jnp.zeros((plan.height, plan.width, 3))
    return SimpleNamespace(
        image=image, hdr=image * 1000, surface=SimpleNamespace(mask=empty[..., 0] == 0, normal=empty)
    )


def test_light_and_buffers_as_numbers(capsys, monkeypatch, folder):
    """An EXR holds light and buffers unmapped, by name; a picture's suffix may ask for light, too."""
    monkeypatch.setattr(sys.modules["jaxraster.render"], "render", small_frame)
    assert run("render triangle.obj --width 8 --height 4 -o a.hdr --aov normal --exr b.exr") == 0
    assert capsys.readouterr().out.endswith("wrote b.exr (R, G, B, normal.X, normal.Y, normal.Z)\n")
    channels = read_exr("b.exr")
    assert channels.keys() == {"R", "G", "B", "normal.X", "normal.Y", "normal.Z"}
    assert channels["G"][0, 0] == 500 and np.isnan(channels["G"][1, 2]) and not channels["normal.X"].any()
    light = read_hdr("a.hdr")
    assert light[0, 0, 0] == 500 and not light[1, 2].any()
    assert sorted(path.name for path in folder.glob("[ab].*")) == ["a.hdr", "a.normal.png", "b.exr"]


OCCLUSIONS = [
    # words, the plan's occlusion, what the plan says of it
    ("", HorizonAO(), "on", "what rises within 0.25 m of a surface in view hides some of its sky"),
    ("--occlusion-radius 2", HorizonAO(radius=2.0), "on", "as asked for"),
    ("--occlusion horizon", HorizonAO(), "on", "as asked for"),
    ("--occlusion ssao --occlusion-radius .5", SSAO(radius=0.5), "on", "as asked for"),
    ("--occlusion none", None, "off", "as asked for"),
    ("--occlusion none --shading local", None, "off", "as asked for"),
    ("--shading local", None, "off", "local shading has no visibility of lights"),
    ("--environment 0", None, "off", "it darkens ambient light alone, and there is none"),
]


@pytest.mark.parametrize(("words", "expected", "on", "why"), OCCLUSIONS, ids=[words for words, *_ in OCCLUSIONS])
def test_what_hides_ambient_light_may_be_chosen(words, expected, on, why, capsys, monkeypatch):
    planned, plan = [], render._plan
    monkeypatch.setattr(render, "_plan", lambda *given: planned.append(plan(*given)) or planned[0])
    monkeypatch.setattr(sys.modules["jaxraster.render"], "render", small_frame)
    assert run(f"render --width 8 --height 4 {words}") == 0
    assert repr(planned[0][0].occlusion) == repr(expected)
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.split()[1] == "occlusion"]
    assert line.split()[0] == on and why in line


def test_a_repair_is_asked_for_and_counted(capsys, monkeypatch, folder):
    monkeypatch.setattr(sys.modules["jaxraster.render"], "render", small_frame)
    assert run("render broken.obj --width 8 --height 4 --repair") == 0
    assert "warning: broken.obj: dropped 1 of 2 faces: " in capsys.readouterr().err


@pytest.mark.parametrize("name", ["cut.gltf", "cut.glb", "empty.gltf", "scene.xyz", "broken.obj", "missing.glb"])
def test_python_and_the_command_line_say_the_same(name, capsys):
    with pytest.raises(Error) as caught:
        jaxraster.load(name)
    assert run(f"render {name}") == caught.value.code
    assert capsys.readouterr().err == f"jaxraster: error: {caught.value}\n"


def test_the_limits_are_listed(capsys):
    """Each by its name, with its number and what it is of; these are what `--limit` takes."""
    assert run("limits") == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == [each.name for each in dataclasses.fields(Limits)]
    assert [int(line.split()[1]) for line in lines] == [each.default for each in dataclasses.fields(Limits)]
    assert "--limit NAME=N" in last


def test_what_is_said_and_written(capsys, monkeypatch, folder):
    """The plan, the seconds, every file; warnings are one line each; stderr is no terminal and shows no progress."""

    monkeypatch.setattr(sys.modules["jaxraster.render"], "render", small_frame)
    assert run("render triangle.obj --width 8 --height 4 -o new.png --aov normal --exposure -1") == 0

    out, err = capsys.readouterr()
    with pytest.warns(AssetWarning):
        scene, camera = jaxraster.load("triangle.obj")
    plan = jaxraster.planner.explain(jaxraster.plan_for(scene, camera, width=8, height=4, exposure=-1.0)[1])
    times, *wrote = out.removeprefix(plan + "\n").splitlines()
    assert re.fullmatch(r"load \d+\.\d\d s · plan \d+\.\d\d s · compile \d+\.\d\d s · frame \d+\.\d\d\d s", times)
    assert wrote == ["wrote new.png (8x4)", "wrote new.normal.png (0.5 + 0.5 n in world space, no curve)"]
    assert err.splitlines() == [
        "jaxraster: warning: triangle.obj: material libraries are missing: 'gone.mtl'",
        "jaxraster: warning: new.png: 1 of 32 pixels are not finite and written as black",
    ]
    image = read_image("new.png")[..., :3]
    assert (image[1, 2] == 0).all() and (np.delete(image.reshape(-1, 3), 10, 0) == np.float32(128 / 255)).all()
    assert (read_image("new.normal.png")[..., :3] == np.float32(128 / 255)).all()


def test_a_full_disk_keeps_the_old_picture(capsys, monkeypatch, folder):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(sys.modules["jaxraster.render"], "render", small_frame)
    monkeypatch.setattr(os, "fsync", full)
    (folder / "render.png").write_bytes(b"old")
    before = sorted(folder.iterdir())
    assert run("render triangle.obj --width 8 --height 4") == 4
    assert "render.png: cannot be written: No space left on device" in capsys.readouterr().err
    assert (folder / "render.png").read_bytes() == b"old" and sorted(folder.iterdir()) == before


def command(words: str) -> dict:
    """How to start the command line as a user does, from this checkout."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"}
    return {"args": [sys.executable, "-m", "jaxraster", *words.split()], "env": environment, "timeout": 300}


def test_a_picture_from_anywhere(folder):
    """The module runs from any folder, draws the built-in scene and each of its buffers, and says nothing on stderr."""
    done = subprocess.run(
        **command("render --width 64 --height 48 --supersample 2 --aov all"), capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    wrote = [line.split(" ")[1] for line in lines if line.startswith("wrote")]
    assert wrote == ["render.png", *(f"render.{name}.png" for name in AOVS)]
    images = {name: read_image(name) for name in wrote}
    assert {image.shape for image in images.values()} == {(48, 64, 4)}
    # The built-in scene emits no light; everything else has something to show.
    dark = [name for name, image in images.items() if image[..., :3].max() == 0]
    assert dark == ["render.emissive.png", "render.emitted.png"]
    assert images["render.png"][..., :3].std() > 0.1


HEEDFUL = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxraster.cli import compare, main, prepare, render
sys.exit(main())
"""


def start_on_a_terminal(words: str, **options) -> tuple[subprocess.Popen, int]:
    """A command whose stderr is a terminal, and our end of that; it takes Ctrl-C even where these tests do not."""
    ours, theirs = pty.openpty()
    start = command(words)
    start.pop("timeout")
    start["args"] = [sys.executable, "-c", HEEDFUL, *words.split()]
    process = subprocess.Popen(**start, stderr=theirs, **options)
    os.close(theirs)
    return process, ours


def read_terminal(terminal: int, until: bytes | None = None) -> str:
    """What appears on a terminal up to a word, or until the process is gone."""
    text = b""
    while until is None or until not in text:
        try:
            text += os.read(terminal, 4096)
        except OSError:  # the other end is closed
            break
    return text.decode("ascii")


def test_progress_on_a_terminal_and_nobody_on_stdout(folder):
    """A terminal on stderr sees each step and a clean line at the end; a closed pipe on stdout stops nothing."""
    read, write = os.pipe()
    os.close(read)
    process, terminal = start_on_a_terminal("render triangle.obj --width 64 --height 48 -o triangle.png", stdout=write)
    os.close(write)
    steps = read_terminal(terminal).split("\r\x1b[K")
    assert process.wait(timeout=300) == 0
    warning = "jaxraster: warning: triangle.obj: material libraries are missing: 'gone.mtl'\r\n"
    assert [step for step in steps if step] == ["loading...", warning, *(f"{doing}..." for doing in STEPS[1:])]
    assert steps[-1] == ""
    assert read_image("triangle.png").shape == (48, 64, 4)


def test_interrupted_while_compiling(folder):
    """Ctrl-C ends it at once and without a word, by the signal itself, which a shell reports as 130."""
    process, terminal = start_on_a_terminal("render triangle.obj", stdout=subprocess.DEVNULL)
    read_terminal(terminal, until=b"compiling...")
    process.send_signal(signal.SIGINT)
    # The compilation alone takes longer than this on an idle machine; a busy one needs a while to tell.
    # Between two steps Python itself takes the signal and exits by the number that a shell would have reported.
    assert process.wait(timeout=20) in (-signal.SIGINT, 130)
    # Nothing is said but, where the next step had begun, its progress and the clearing of its line.
    assert read_terminal(terminal).replace("\x1b[K", "").strip() in ("", "rendering...")
    assert not (folder / "render.png").exists()

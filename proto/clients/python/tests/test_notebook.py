"""The widget of notebooks: what it answers to its front end, and a drag in Chromium against the real server."""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pliant
from conftest import ROOT

comm = pytest.importorskip("comm", reason="anywidget is not installed")
pytest.importorskip("anywidget", reason="anywidget is not installed")

from pliant import notebook  # noqa: E402

PAGE = ROOT / "tests/clients/notebook/page.mjs"
STILL = {"by": [0, 0, 0], "turn": [0, 0, 0], "end": False}


class Front(comm.base_comm.BaseComm):  # type: ignore[misc]
    """The way from a widget to its front end: what it sends, as lines of a page would get it."""

    sent: list[dict[str, Any]] = []
    hear: Callable[[dict[str, Any]], None] = sent.append

    def publish_msg(self, msg_type: str, data: Any = None, metadata: Any = None, buffers: Any = None, **_: Any) -> None:
        if data is None or "method" not in data and "state" not in data:
            return
        binary = [{"base64": base64.b64encode(buffer).decode()} for buffer in buffers or []]
        if data.get("method") == "custom":
            type(self).hear({"custom": data["content"], "buffers": binary})
            return
        state = {name: value for name, value in data["state"].items() if not name.startswith("_")}
        for path, value in zip(data.get("buffer_paths", []), binary):
            [state[path[0]]] = [value]
        type(self).hear({"state": json.loads(json.dumps(state, default=str))})


@pytest.fixture
def session(server: pliant.LocalServer, creature: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[pliant.Session]:
    """The creature with handles, whose widgets send to a Front."""
    monkeypatch.setattr(comm, "create_comm", Front)
    monkeypatch.setattr(Front, "sent", [])
    monkeypatch.setattr(Front, "hear", Front.sent.append)
    with pliant.open(creature, server=server) as opened:
        opened.handle("feet", half_space=((0, -1, 0), -0.14))
        opened.handle("head", sphere=((0.76, 1.22, 0), 0.36))
        opened.handle("tail", sphere=((-1.0, 1.06, 0), 0.16))
        yield opened


def ask(widget: notebook.Widget, **request: Any) -> dict[str, Any]:
    """What a front end asks, and the answer that it gets."""
    before = len(Front.sent)
    widget._handle_msg({"content": {"data": {"method": "custom", "content": {"view": "v", **request}}}, "buffers": []})
    [answer] = [line for line in Front.sent[before:] if "custom" in line]
    assert answer["custom"]["view"] == "v"
    return answer


def shape(answer: dict[str, Any]) -> np.ndarray:
    [buffer] = answer["buffers"]
    return np.frombuffer(base64.b64decode(buffer["base64"]), "<f4").reshape(-1, 3)


def place(widget: notebook.Widget, handle: str) -> np.ndarray:
    [found] = [entry["place"] for entry in widget.handles if entry["id"] == handle]
    return np.array(found)


def test_a_drag_is_solved_and_recorded_once(session: pliant.Session) -> None:
    widget = session.widget(height=300)
    rest, before = session.positions(), place(widget, "head")
    assert np.array_equal(np.frombuffer(widget.positions, "<f4").reshape(-1, 3), rest)
    assert np.array_equal(np.frombuffer(widget.triangles, "<u4").reshape(-1, 3), session.triangles())
    welded = np.frombuffer(widget.welded, "<u4")
    assert np.array_equal(rest[welded], rest) and len(np.unique(welded)) == len(np.unique(rest, axis=0))
    revision = session.info.revision
    for step in (0.1, 0.2, 0.3):
        moving = shape(ask(widget, kind="drag", id="head", **{**STILL, "by": [0, step, 0]}))
    assert np.abs(moving - rest).max() > 0.2 and session.refresh().revision == revision
    released = ask(widget, kind="drag", id="head", **{**STILL, "by": [0, 0.3, 0], "end": True})
    assert released["custom"]["error"] == "" and released["buffers"] == []
    assert session.refresh().revision == revision + 1 and [c.kind for c in session.history()][-1] == "pose"
    assert np.array_equal(np.frombuffer(widget.positions, "<f4").reshape(-1, 3), session.positions())
    assert np.allclose(place(widget, "head"), before + [0, 0.3, 0]), "the dot is where the handle is"
    ask(widget, kind="undo")
    assert np.array_equal(session.positions(), rest) and np.allclose(place(widget, "head"), before)
    ask(widget, kind="redo")
    assert np.allclose(place(widget, "head"), before + [0, 0.3, 0])
    assert "nothing" in ask(widget, kind="redo")["custom"]["error"]


def test_drags_add_up(session: pliant.Session) -> None:
    widget = session.widget(free_rotation=False)
    before = place(widget, "head")

    def release(by: list[float], turn: list[float]) -> None:
        assert ask(widget, kind="drag", id="head", by=by, turn=turn, end=True)["custom"]["error"] == ""

    session.solve({"head": {"rotation_vector": (0, 0, 0.4), "scale": 1.2, "translation": (0.1, 0, 0)}})
    widget.refresh()
    posed, at = session.positions(), place(widget, "head")
    release([0, 0.1, 0], [0, 0, 0])
    head = np.linalg.norm(posed - at, axis=1) < 0.2
    assert np.allclose(session.positions()[head], posed[head] + [0, 0.1, 0], atol=1e-4), "moved, turned and scaled as it was"
    # A turn about the joint, and back.
    release([0, 0, 0], [0, 0.5, 0])
    assert np.abs(place(widget, "head") - at - [0, 0.1, 0]).max() > 0.02
    release([0, 0, 0], [0, -0.5, 0])
    assert np.allclose(place(widget, "head"), at + [0, 0.1, 0], atol=1e-6)
    release((before - at - [0, 0.1, 0]).tolist(), [0, 0, 0])
    assert np.allclose(place(widget, "head"), before, atol=1e-6)


def test_what_is_moved_turns_freely_until_somebody_turns_it(session: pliant.Session) -> None:
    widget = session.widget()
    poses = []
    for by, turn in [([0, 0.2, 0], [0, 0, 0]), ([0.1, 0, 0], [0, 0, 0]), ([0, 0, 0], [0, 0.3, 0]), ([0.1, 0, 0], [0, 0, 0])]:
        assert ask(widget, kind="drag", id="head", by=by, turn=turn, end=True)["custom"]["error"] == ""
        [facts] = [handle for handle in session.info.handles if handle.id == "head"]
        poses.append(facts.pose.free_rotation)
    assert poses == [True, True, False, False]


def test_a_drag_that_cannot_be_ends_and_says_why(session: pliant.Session) -> None:
    widget = session.widget()
    rest, revision = session.positions(), session.info.revision
    shape(ask(widget, kind="drag", id="head", **{**STILL, "by": [0, 0.2, 0]}))
    assert ask(widget, kind="drag", id="head", **{**STILL, "end": True}, cancel=True)["custom"]["error"] == ""
    assert session.refresh().revision == revision and np.array_equal(session.positions(), rest)
    assert "no handle 'hed'" in ask(widget, kind="drag", id="hed", **STILL)["custom"]["error"]
    assert "1e" in ask(widget, kind="drag", id="head", **{**STILL, "by": [1e300, 0, 0]})["custom"]["error"]
    assert "KeyError" in ask(widget, kind="dance")["custom"]["error"]
    assert session.refresh().revision == revision
    # After an edit in another cell the next drag is of the new mesh.
    session.edit(subdivide={"scheme": "loop"})
    answer = ask(widget, kind="drag", id="head", **{**STILL, "by": [0, 0.1, 0]})
    assert len(shape(answer)) == session.vertices > len(rest), answer["custom"]["error"]
    assert len(widget.positions) == 12 * session.vertices


def test_far_from_the_origin_the_front_end_gets_small_numbers(server: pliant.LocalServer, session: pliant.Session) -> None:
    far = np.array([5e6, 4e6, 100.0])
    with pliant.open((session.positions().astype(np.float64) + far, session.triangles()), server=server) as moved:
        moved.handle("feet", half_space=((0, -1, 0), -0.14 - 4e6))
        moved.handle("head", sphere=(far + (0.76, 1.22, 0), 0.36))
        widget = moved.widget()
        assert len(moved.info.origin) == 3
        origin = np.array(moved.info.origin)
        shown = np.frombuffer(widget.positions, "<f4").reshape(-1, 3)
        assert np.allclose(shown, session.positions() + (far - origin), atol=1e-5)
        assert np.linalg.norm(place(widget, "head") + origin - far - [0.76, 1.22, 0]) < 0.3
        frame = shape(ask(widget, kind="drag", id="head", **{**STILL, "by": [0, 0.2, 0]}))
        assert 0.1 < np.abs(frame - shown).max() < 1


def test_without_anywidget_it_says_what_to_install() -> None:
    code = "import sys; sys.modules['anywidget'] = None; import pliant; import pliant.notebook"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "ImportError: a widget needs anywidget: pip install 'pliant[notebook]'" in done.stderr


def has_browser() -> None:
    if not PAGE.is_file():
        pytest.skip("this is not a checkout")
    if shutil.which("node") is None:
        pytest.skip("node is not installed; the widget was not tried in a browser")
    if not (ROOT / "tests/clients/viewer/node_modules/playwright-core").is_dir():
        pytest.skip("playwright-core is not installed (npm ci --prefix tests/clients/viewer); the widget was not tried in a browser")
    if not any(map(shutil.which, [os.environ.get("CHROMIUM", ""), "chromium", "chromium-browser", "google-chrome"])):
        pytest.skip("Chromium is not installed; the widget was not tried in a browser")


@pytest.mark.parametrize("colors", ["light", "dark"])
def test_handles_are_dragged_in_a_browser(session: pliant.Session, colors: str, monkeypatch: pytest.MonkeyPatch) -> None:
    has_browser()
    pictures = Path(os.environ.get("NOTEBOOK_PICTURES", ROOT / "target/notebook"))
    pictures.mkdir(parents=True, exist_ok=True)
    page = subprocess.Popen(["node", PAGE, pictures, colors], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert page.stdin is not None and page.stdout is not None

    def write(line: dict[str, Any]) -> None:
        page.stdin.write(json.dumps(line) + "\n")
        page.stdin.flush()

    monkeypatch.setattr(Front, "hear", write)
    widget = session.widget()
    rest, first = session.positions(), session.info.revision
    end, requests = None, 0
    for line in map(json.loads, page.stdout):
        if "custom" in line:
            requests += 1
            widget._handle_msg({"content": {"data": {"method": "custom", "content": line["custom"]}}, "buffers": []})
            continue
        scene = line["scene"]
        if scene == "end":
            end = line
            break
        history = [commit.kind for commit in session.history() if commit.revision > first]
        current = session.positions()
        if scene == "moved":
            assert history == ["pose"] and np.abs(current - rest).max() > 0.1, "one commit for the whole drag"
            moved = current
        elif scene == "turned":
            assert history == ["pose", "pose"] and np.abs(current - moved).max() > 0.05
            turned = current
        elif scene == "taken back":
            assert history == ["pose", "pose"] and np.array_equal(current, turned)
        elif scene == "undone":
            assert np.array_equal(current, moved)
        elif scene == "edited elsewhere":
            session.clear_handles()
            session.handle("feet", half_space=((0, -1, 0), -0.14))
            session.apply()
        write({"go": scene})
    assert page.wait(timeout=60) == 0 and end is not None
    assert "no handle 'head'" in end["refusal"] and end["isTakenBack"], "what was taken back is not shown"
    assert end["complaints"] == [] and end["asked"] == [], "nothing is fetched, and the console is quiet"
    assert requests >= 10

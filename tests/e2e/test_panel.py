"""`treewright panel` as the person at the robot uses it: by clicks and keys in a browser, on the simulated cell."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import zenoh
from playwright.sync_api import Browser, Page, expect
from support_browser import PHONE, TABLET, Watched, chromium
from support_cell import free_endpoint, session_on
from support_processes import daemon

from learner.model import Definition, GripperIs, InGripper, Node, ObjectRoughlyAt, Pose, SetGripper, Tree
from learner.model.tree import fallback, leaf, sequence, subtree
from learner.simulation.scenarios import scenario_named
from pipelines.panel.access.tokens import Tokens
from pipelines.simulated_cell.operator import Behavior, ScriptedOperator
from recorder.recording import read_recording
from recorder.wire import pose_message
from storage.artifacts import ArtifactStore

pytestmark = pytest.mark.e2e

SCENARIO, SPEED = "object_in_box", 4.0
DOWN = (1.0, 0.0, 0.0, 0.0)
IN_BOX = ObjectRoughlyAt("A", "box", (0.0, 0.0, 0.0), 0.1)
DOUBT = "A may belong <b>anywhere</b>; move the box, leave A, show it once more"
EVIDENCE = {"type": "drop", "object": "A", "frame": "box", "samples": 3, "spread_m": 0.012, "certainty": 0.98}
FACTS = {"base_frame": "base", "end_effector_frame": "tool0", "report": {"actions": [EVIDENCE]}}


def motion(kind: str, frame: str, at: tuple[float, float, float]) -> Node:
    return Node(kind, (("frame", frame), ("object", "A"), ("orientation", DOWN), ("position", at)))


HOLD = fallback(
    leaf(InGripper("A")),
    sequence(fallback(leaf(GripperIs("open")), leaf(SetGripper("open"))), motion("Pick", "A", (0.0, 0.0, 0.0))),
)
TURN = Definition("Recover_Turn", sequence(leaf(GripperIs("open")), motion("Pick", "A", (0.0, 0.0, 0.0))))
DROP = sequence(subtree("Hold"), motion("Drop", "box", (0.0, 0.0, 0.1)))
TREE = Tree(
    Definition("tidy", sequence(fallback(leaf(IN_BOX), DROP, subtree("Recover_Turn"), reactive=False))),
    (Definition("Hold", HOLD), TURN),
)


class Hand(ScriptedOperator):
    """Leads the hand of the simulated cell; what it would press, `press` is told instead."""

    press: Callable[[str], None]

    def _press(self, kind: str, name: str) -> None:
        self.press(kind)


@dataclass
class Site:
    """A simulated cell with recorder and panel, and a browser."""

    home: Path
    endpoint: str
    session: zenoh.Session
    url: str
    browser: Browser

    def hand(self, press: Callable[[str], None], seed: int = 1) -> Hand:
        behavior = replace(Behavior(), pause_s=(0.0, 0.05), settle_s=0.5)
        hand = Hand(self.session, "c1", scenario_named(SCENARIO), np.random.default_rng(seed), behavior)
        hand.press = press
        return hand

    def ask(self, verb: str) -> dict[str, object]:
        (reply,) = self.session.get(f"treewright/c1/{verb}", payload="{}", timeout=10.0)
        assert reply.ok is not None
        answer: dict[str, object] = json.loads(reply.ok.payload.to_bytes())
        return answer


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    home, endpoint = tmp_path_factory.mktemp("panel"), free_endpoint()
    with ArtifactStore(home / "store") as store:
        store.publish("tidy", TREE, FACTS)
        store.judge("tidy", 1, [DOUBT], 1)
    with ExitStack() as stack:
        words = ["--cell", "c1", "--connect", endpoint]
        session = stack.enter_context(session_on(endpoint, "listen"))
        sim = ["--scenario", SCENARIO, "--speed", str(SPEED), "--seed", "3"]
        daemons = [
            stack.enter_context(daemon(home, *command, *words))
            for command in (["sim", *sim], ["record"], ["panel", "--port", "0"])
        ]
        browser = stack.enter_context(chromium())
        assert all(each.hear() == {"ready": True} for each in daemons)
        yield Site(home, endpoint, session, daemons[-1].hear()["url"], browser)


@pytest.fixture
def watched(site: Site, request: pytest.FixtureRequest) -> Iterator[Watched]:
    """A page of the panel, of the size and in the language of a test's parameter, else English on a tablet."""
    size, language = getattr(request, "param", (TABLET, "en-US"))
    with Watched(site.browser, size, language) as page:
        yield page


JUMPED_S = 2.0
"""A marker that jumped so long before a press [s] is no reason to doubt it."""


def key(page: Page, name: str) -> None:
    page.keyboard.press(name)


def verdict(page: Page) -> str:
    return page.get_by_role("status").inner_text()


def begin(site: Site, page: Page, user: str) -> None:
    """Name the task and start, on a page that was just opened."""
    page.goto(site.url)
    page.get_by_label("Task").fill("tidy")
    page.get_by_label("Your name").fill(user)
    page.get_by_role("button", name="Start").click()
    expect(page.get_by_role("status")).to_contain_text("Recording")


def test_a_task_is_shown_by_clicks_and_keys_and_a_wrong_press_is_taken_back(site: Site, watched: Watched) -> None:
    page = watched.page
    site.hand(lambda kind: None).reset()
    time.sleep(JUMPED_S)
    begin(site, page, "ann")

    def press(kind: str) -> None:
        if kind == "pick":
            key(page, "p")
            expect(page.get_by_role("status")).to_have_text("0. Pick A: good")
            return
        key(page, "p")  # while A is held: wrong
        expect(page.get_by_role("status")).to_contain_text("contradicts")
        assert "Press Undo" in verdict(page)
        watched.picture("teach")
        page.get_by_role("button", name="Undo").click()
        expect(page.get_by_role("status")).to_have_text("Action 1 is taken back.")
        page.get_by_role("button", name=kind.capitalize(), exact=False).click()
        expect(page.get_by_role("status")).to_contain_text(f"{kind.capitalize()} A: good")

    site.hand(press).perform()
    page.reload()
    steps = page.locator(".tw-step")
    expect(steps).to_have_count(3)
    expect(steps.nth(0)).to_have_text("0. Pick A: good")
    expect(steps.nth(1)).to_contain_text("taken back")
    expect(steps.nth(2)).to_contain_text("A: good")
    key(page, "k")
    expect(page.get_by_role("status")).to_contain_text("kept")
    expect(page.get_by_text("A was taken.")).to_be_visible(timeout=20_000)
    expect(page.get_by_text("Learned: tidy version 2")).to_be_visible(timeout=60_000)
    (file,) = (site.home / "recordings" / "c1").glob("*.mcap")
    recording = read_recording([file])
    assert (recording.task, recording.user, recording.outcome) == ("tidy", "ann", "success")


def test_a_tree_is_unfolded_to_its_last_leaf_and_its_doubts_are_taken_on(site: Site, watched: Watched) -> None:
    page = watched.page
    page.goto(f"{site.url}/understand?task=tidy&version=1")
    assert page.get_by_text(DOUBT).count() == 1
    assert page.get_by_text("Is A held?").count() == 0
    page.get_by_text("Pick A and Drop at (0, 0, 100) mm in box").click()
    for words in ("The first that works of", "One after the other, each kept true", "The first that holds or works of"):
        page.get_by_role("button", name=words).last.click(timeout=5000)
    page.get_by_text("Is A held?").click()
    expect(page.get_by_text("object = A")).to_be_visible()
    page.get_by_role("button", name="Drop A with the hand").click()
    expect(page.get_by_text("shown 3 times, spread 12 mm")).to_be_visible()
    repair = page.get_by_text("Repairs what was not demonstrated (3 nodes)")
    expect(repair).to_be_hidden()
    page.get_by_text("show what repairs").click()
    expect(repair).to_be_visible()

    watched.picture("understand")
    page.get_by_label("Your name").fill("")
    page.get_by_role("button", name="Approve").click()
    expect(page.locator(".q-notification")).to_be_visible()
    page.get_by_label("Your name").fill("eve")
    page.get_by_role("button", name="Approve").click()
    page.get_by_role("button", name="Set as production").click()
    expect(page.locator(".tw-alias", has_text="production")).to_be_visible()
    with ArtifactStore(site.home / "store") as store:
        assert store.aliases("tidy")["production"] == 1
        assert [each["by"] for each in store.get("tidy", 1).standing.approved] == ["eve"]


def test_a_version_that_is_not_there_is_told_in_a_sentence(site: Site, watched: Watched) -> None:
    watched.page.goto(f"{site.url}/understand?task=tidy&version=77")
    expect(watched.page.locator(".q-notification")).to_contain_text("77")


def test_a_tree_is_run_watched_stopped_by_the_space_bar_and_run_to_its_goal(site: Site, watched: Watched) -> None:
    with ArtifactStore(site.home / "store") as store:
        if store.get("tidy", 1).standing.doubtful:
            store.approve("tidy", 1, "eve")
        store.alias("tidy", "production", 1)
    site.hand(lambda kind: None).reset()
    page = watched.page
    status = page.get_by_role("status")
    page.goto(f"{site.url}/run")
    expect(status).to_have_text("Nothing runs.")
    placement = page.locator(".tw-row", has_text="Pick A and Drop at (0, 0, 100) mm in box")
    expect(page.get_by_role("button", name="Start")).to_be_enabled()
    key(page, "r")
    expect(status).to_contain_text("under way: Pick A in A", timeout=20_000)
    expect(placement).to_have_class(re.compile("running"))
    watched.picture("run")
    page.get_by_label("Task and version").focus()
    key(page, " ")
    expect(status).to_contain_text("tidy@1: stopped")
    assert site.ask("sim/truth")["goal"] is False

    expect(page.get_by_role("button", name="Start")).to_be_enabled()
    key(page, "r")
    expect(status).to_contain_text("under way", timeout=20_000)
    page.reload()
    expect(status).to_contain_text("tidy@1")
    expect(status).to_contain_text("tidy@1: done", timeout=30_000)
    assert site.ask("sim/truth")["goal"] is True


def test_stop_without_a_run_is_answered_in_a_sentence_and_another_sites_page_is_refused(site: Site) -> None:
    own = site.browser.new_context().request.post(f"{site.url}/stop")
    assert (own.status, "error" in own.json()) == (409, True)
    foreign = site.browser.new_context().request.post(f"{site.url}/stop", headers={"Origin": "http://evil.example"})
    assert foreign.status == 403


def test_an_operator_from_another_machine_sees_but_does_not_judge_and_an_engineer_signs(site: Site) -> None:
    tokens = Tokens(site.home / "tokens.json")
    secrets = {name: tokens.add(name, role) for name, role in (("otto", "operator"), ("erna", "engineer"))}
    with ArtifactStore(site.home / "store") as store:
        version = store.publish("other", TREE, FACTS).version
        store.judge("other", version, [DOUBT], 1)
    words = ("--cell", "c1", "--host", "0.0.0.0", "--port", "0", "--connect", site.endpoint)
    with daemon(site.home, "panel", *words) as panel:
        assert panel.hear() == {"ready": True}
        url = panel.hear()["url"].replace("0.0.0.0", "127.0.0.1")
        for name, secret in secrets.items():
            with Watched(site.browser, context=site.browser.new_context()) as watched:
                page = watched.page
                page.goto(f"{url}/understand?task=other")
                page.get_by_label("Your token").fill(secret)
                page.get_by_role("button", name="Enter").click()
                expect(page.get_by_label("Your name")).to_have_value(name)
                page.goto(f"{url}/understand?task=other")
                expect(page.get_by_text(DOUBT)).to_be_visible()
                approve = page.get_by_role("button", name="Approve")
                assert approve.count() == (name == "erna")
                if name == "erna":
                    approve.click()
                    expect(page.get_by_text("by erna")).to_be_visible()


@pytest.mark.parametrize("watched", [(TABLET, "de-DE")], indirect=True)
def test_every_page_fits_a_tablet_and_a_phone_in_the_language_of_longer_words(site: Site, watched: Watched) -> None:
    for path in ("/", "/understand", "/run"):
        watched.page.goto(f"{site.url}{path}")
        expect(watched.page.locator("main .tw-card").first).to_be_visible()
        for width, height in (TABLET, PHONE):
            watched.page.set_viewport_size({"width": width, "height": height})
            assert watched.overflow_px <= 0, (path, width)
            assert watched.overlapping() == [], (path, width)


@pytest.mark.parametrize("watched", [(PHONE, "de-DE")], indirect=True)
def test_names_with_scripts_in_them_are_shown_as_they_are_written(site: Site, watched: Watched) -> None:
    evil = "<img src=x onerror=\"document.title='caught'\">'\"&"
    page = watched.page
    page.goto(site.url)
    poses = site.session.declare_publisher("treewright/c1/poses")
    poses.put(pose_message(time.time_ns(), "base", {evil: Pose((0.4, 0.0, 0.0))}))
    expect(page.locator(".tw-light", has_text="onerror")).to_contain_text(evil)
    expect(page.locator(".tw-table text", has_text="onerror")).to_have_text(evil)
    page.get_by_label("Aufgabe").fill("tidy")
    page.get_by_label("Ihr Name").fill(evil)
    page.get_by_role("button", name="Start").click()
    expect(page.get_by_role("status")).to_contain_text("onerror")
    assert page.locator("main img").count() == 0
    assert page.title() == "Vormachen · c1"
    assert watched.overflow_px <= 0

"""What can be checked of the images without building them: their files, their packages, their commands."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipelines import cli

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
IMAGES = sorted(DOCKER.glob("Dockerfile.*"))


def compose() -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    return document


def instructions(image: Path) -> list[str]:
    """The lines of a Dockerfile, continued ones joined."""
    text = re.sub(r"\\\n", " ", re.sub(r"(?m)^#.*\n", "", image.read_text()))
    return [re.sub(r" +", " ", line) for line in text.splitlines() if line]


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: str(image.name))
def test_what_an_image_copies_is_there_and_passes_the_ignore_file(image: Path) -> None:
    passed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [word for line in instructions(image) if line.startswith("COPY ") for word in line.split()[1:-1]]
    assert copied
    assert [name for name in copied if not (ROOT / name).exists() or name not in passed] == []


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: str(image.name))
def test_an_image_runs_as_nobody_special_and_gets_the_signals(image: Path) -> None:
    lines = instructions(image)
    assert "USER treewright" in lines
    assert 'ENTRYPOINT ["treewright"]' in lines


def test_the_recorders_image_installs_all_that_recording_loads() -> None:
    (line,) = [line for line in instructions(DOCKER / "Dockerfile.recorder") if "--constraint" in line]
    installed = {
        name.lower().replace("_", "-") for name in line.partition("requirements.lock")[2].split("&&")[0].split()
    }
    script = "import recorder.daemon, pipelines.network.session, sys, zenoh, zenoh.ext; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    found = packages_distributions()
    loaded = {name.lower().replace("_", "-") for module in done.stdout.split() if "." not in module
              for name in found.get(module, ())}  # fmt: skip
    brought_along = {"lz4", "typing-extensions", "setuptools", "treewright"}
    assert loaded - installed - brought_along == set()


def test_compose_builds_images_that_are_there_and_starts_commands_that_exist() -> None:
    services = compose()["services"]
    assert set(services) == {"recorder", "service"}
    for service in services.values():
        assert (ROOT / service["build"]["dockerfile"]).is_file()
        words = [re.sub(r"\$\{\w+:-(\w+)\}", r"\1", word) for word in service["command"]]
        assert cli._parser(words[0]).parse_args(words).command == words[0]


def test_docker_accepts_the_compose_file() -> None:
    if not shutil.which("docker") or subprocess.run(["docker", "compose", "version"], capture_output=True).returncode:
        pytest.skip("docker compose is not here")
    subprocess.run(["docker", "compose", "-f", str(DOCKER / "compose.yaml"), "config", "-q"], check=True)

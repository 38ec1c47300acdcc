"""Which way imports point: pipelines to recorder and storage, those to the learner, the learner to nobody."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGES = ("learner", "recorder", "storage", "pipelines")
MAY_IMPORT = {
    "learner": {"learner"},
    "recorder": {"recorder", "learner"},
    "storage": {"storage", "learner"},
    "pipelines": set(PACKAGES),
}
HOMES = {
    "pybullet": "learner/simulation/",
    "pybullet_data": "learner/simulation/",
    "prefect": "pipelines/flows/",
    "nicegui": "pipelines/panel/",
}
IO = {"zenoh", "mcap", "pyarrow", "deltalake", "sqlalchemy", "fastapi", "uvicorn", "prefect", "socket", "requests"}

ORDER = {
    "learner": (
        "errors progress stages",
        "model",
        "numbers",
        "observation relations",
        "execution",
        "inference",
        "planning proof",
        "regularities",
        "simulation",
        "learned",
        "paper",
        "rehearsal",
        "treewright",
        "learning",
    ),
    "recorder": (
        "paths durable",
        "errors notices",
        "wire disk foxglove",
        "clocks",
        "recording",
        "salvage replay imports intake upload",
        "recovery teaching",
        "daemon",
    ),
    "pipelines": (
        "errors options",
        "console home reference network",
        "progress profile",
        "steps controller simulated_cell",
        "service",
        "flows demo panel",
        "commands",
        "cli",
    ),
}
"""The rooms of a package, each line above all that may import it; of one line none imports another. `numbers` are the
parameters, which each folder tells and `learner.parameters` gathers."""
MOST_FILES = 19


def room_of(parts: tuple[str, ...]) -> str:
    """The room of a module: the folder in the package, or the module beside the folders."""
    if parts[0] == "learner" and parts[-1] == "parameters":
        return "numbers"
    return parts[0] if len(parts) == 1 or parts[1] == "__init__" else parts[1]


def modules(package: str) -> Iterator[Path]:
    yield from sorted((ROOT / package).rglob("*.py"))


def imported(file: Path) -> set[str]:
    """Every module that a file imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file} imports relatively"
            names.add(str(node.module))
    return names


def imported_at_run_time(file: Path) -> set[str]:
    """As `imported`, without what stands under `if TYPE_CHECKING`."""
    tree = ast.parse(file.read_text())
    skipped = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    return {
        str(node.module) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node not in skipped
    }  # fmt: skip


def tops(file: Path) -> set[str]:
    return {name.partition(".")[0] for name in imported(file)}


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_point_to_the_learner(package: str) -> None:
    forbidden = set(PACKAGES) - MAY_IMPORT[package]
    assert {str(file): found for file in modules(package) if (found := tops(file) & forbidden)} == {}


def test_the_learner_does_no_input_or_output() -> None:
    assert {str(file): found for file in modules("learner") if (found := tops(file) & IO)} == {}


def test_the_words_need_numpy_and_the_standard_library_alone() -> None:
    allowed = {"numpy", "learner", *sys.stdlib_module_names}
    inner = {name for file in modules("learner/model") for name in imported(file) if name.startswith("learner")}
    assert {str(file): found for file in modules("learner/model") if (found := tops(file) - allowed)} == {}
    assert {name for name in inner if not name.startswith(("learner.model", "learner.errors"))} == set()


@pytest.mark.parametrize("package", ORDER)
def test_rooms_import_only_what_stands_before_them(package: str) -> None:
    ranks = {room: rank for rank, rooms in enumerate(ORDER[package]) for room in rooms.split()}
    assert {room_of(file.relative_to(ROOT).with_suffix("").parts) for file in modules(package)} <= {*ranks, package}
    backward = {
        f"{file.relative_to(ROOT)} imports {name}"
        for file in modules(package)
        for name in imported(file)
        if name.startswith(f"{package}.")
        for here, there in [(room_of(file.relative_to(ROOT).with_suffix("").parts), room_of(tuple(name.split("."))))]
        if here != package and here != there and ranks[there] >= ranks[here]
    }
    assert backward == set()


def test_no_module_imports_itself_in_a_circle() -> None:
    """What is imported inside a function counts; what only a type checker reads does not."""
    files = {".".join(file.relative_to(ROOT).with_suffix("").parts): file for p in PACKAGES for file in modules(p)}
    arrows = {name: imported_at_run_time(file) & set(files) for name, file in files.items()}
    left = dict(arrows)
    while free := [name for name, towards in left.items() if not towards & set(left)]:
        for name in free:
            del left[name]
    assert left == {}


def test_no_folder_is_too_full_to_be_read_in_one_look() -> None:
    counts = {
        folder: len(list(folder.glob("*.py"))) for p in PACKAGES for folder in [ROOT / p, *(ROOT / p).rglob("*/")]
    }
    assert {str(folder): count for folder, count in counts.items() if count > MOST_FILES} == {}


def test_a_checker_does_not_import_what_it_checks() -> None:
    checked = ("learner.planning", "learner.inference", "learner.paper", "learner.rehearsal")
    names = {name for file in modules("learner/proof") for name in imported(file)}
    assert {name for name in names if name.startswith(checked)} == set()


@pytest.mark.parametrize("library", HOMES)
def test_a_library_with_one_home_is_imported_nowhere_else(library: str) -> None:
    importers = {file.relative_to(ROOT).as_posix() for package in PACKAGES for file in modules(package)
                 if library in tops(file)}  # fmt: skip
    assert importers
    assert {file for file in importers if not file.startswith(HOMES[library])} == set()


def loaded_by(statement: str) -> set[str]:
    """The modules that a fresh interpreter holds after a statement."""
    script = f"{statement}\nimport sys; print(' '.join(sys.modules))"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=True)
    return {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}


def test_what_a_controller_imports_of_the_store_is_light() -> None:
    assert loaded_by("import storage.client").isdisjoint({"sklearn", "pyarrow", "prefect", "pybullet"})


def test_help_and_the_frame_of_the_command_line_load_nothing_heavy() -> None:
    heavy = {"numpy", "sklearn", "scipy", "pyarrow", "prefect", "pybullet", "zenoh", "mcap", "sqlalchemy", "fastapi"}
    ask = "import contextlib, io\nfrom pipelines.cli import main"
    show = "with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()): main(['--help'])"
    assert loaded_by(f"{ask}\n{show}").isdisjoint(heavy)


def test_every_command_shows_its_options_without_loading_what_it_needs_to_run() -> None:
    heavy = {"sklearn", "pyarrow", "prefect", "pybullet", "deltalake", "fastapi", "nicegui"}
    commands = [file.stem.rstrip("_") for file in modules("pipelines/commands") if file.stem != "__init__"]
    ask = "import contextlib, io\nfrom pipelines.cli import main"
    show = (
        f"for name in {commands}:\n"
        "  with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()): main([name, '--help'])"
    )
    assert commands
    assert loaded_by(f"{ask}\n{show}").isdisjoint(heavy)

"""From results to tables in Markdown."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Any

Result = dict[str, Any]
Row = Sequence[object]


def table(head: Sequence[str], rows: Iterable[Row]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def grouped(results: Iterable[Result], *names: str) -> dict[tuple[Any, ...], list[Result]]:
    """Results by the values of some of their fields, in order of appearance."""
    groups: dict[tuple[Any, ...], list[Result]] = defaultdict(list)
    for result in results:
        groups[tuple(result[name] for name in names)].append(result)
    return dict(groups)


def runs_of(results: Iterable[Result], keep: Callable[[Result], bool] = lambda run: True) -> list[Result]:
    """All runs of some cells that `keep` wants; a cell that was refused has none."""
    return [run for result in results for run in result["runs"] if keep(run)]


def plain(run: Result) -> bool:
    """Whether no way out had to be found that no demonstration shows."""
    return not run["beyond"]


def beyond(run: Result) -> bool:
    return bool(run["beyond"])


def share(runs: Sequence[Result]) -> str:
    """How many of the runs succeeded."""
    done = sum(run["verdict"] == "done" for run in runs)
    return f"{100 * done / len(runs):.1f} % of {len(runs)}" if runs else "-"


def worst(results: Sequence[Result], keep: Callable[[Result], bool] = plain) -> str:
    """The share of the worst set of demonstrations; a refused set counts as none done."""
    shares = []
    for result in results:
        runs = runs_of([result], keep)
        shares.append(sum(run["verdict"] == "done" for run in runs) / len(runs) if runs else 0.0)
    return f"{100 * min(shares):.0f} %" if shares else "-"


def false_successes(runs: Sequence[Result]) -> int:
    return sum(run["verdict"] == "false success" for run in runs)


def sizes(results: Sequence[Result]) -> str:
    """The range of the nominal sizes."""
    found = sorted(result["nodes"] for result in results if "nodes" in result)
    if not found:
        return "-"
    return str(found[0]) if found[0] == found[-1] else f"{found[0]} to {found[-1]}"


def limit(results: Sequence[Result]) -> int | str:
    """The bar on the size: 11k + 1 nodes for one goal group, 11k + g + 1 for g of them."""
    if not any("nodes" in result for result in results):
        return "-"
    groups = max((result.get("groups", 1) for result in results), default=1)
    k = max((result.get("k", 0) for result in results), default=0)
    return 11 * k + 1 + (groups if groups > 1 else 0)


def success_table(results: Sequence[Result]) -> str:
    """One row per task, cell and method: all numbers of demonstrations together."""
    head = ("task", "cell", "method", "refused sets", "done", "worst set", "false success", "recovery", "contacts/run",
            "nodes", "bar")  # fmt: skip
    rows = []
    for (task, users, method), cells in grouped(results, "scenario", "users", "method").items():
        runs = runs_of(cells, plain)
        contacts = f"{sum(run['contacts'] for run in runs) / len(runs):.2f}" if runs else "-"
        rows.append((task, users, method, sum("refused" in cell for cell in cells), share(runs), worst(cells),
                     false_successes(runs_of(cells)), share(runs_of(cells, beyond)), contacts, sizes(cells),
                     limit(cells)))  # fmt: skip
    return table(head, rows)


def demonstrations_table(results: Sequence[Result]) -> str:
    """Success against the number of demonstrations, all tasks pooled."""
    head = ("method", "cell", "demonstrations", "done", "worst set", "recovery", "false success")
    rows = [
        (method, users, count, share(runs_of(cells, plain)), worst(cells), share(runs_of(cells, beyond)),
         false_successes(runs_of(cells)))
        for (method, users, count), cells in sorted(grouped(results, "method", "users", "demonstrations").items())
    ]  # fmt: skip
    return table(head, rows)


def kinds_table(results: Sequence[Result]) -> str:
    """Success by what happened to the robot, for each method; `recovery` where a way out had to be found."""
    methods = sorted({result["method"] for result in results})
    head = ("disturbance", "when", *(f"{method}: {what}" for method in methods for what in ("done", "recovery")))
    kinds = list(dict.fromkeys((run["disturbance"], run["when"]) for run in runs_of(results)))
    rows = [(name, when, *_by_method(results, methods, name, when)) for name, when in kinds]
    return table(head, rows)


def _by_method(results: Sequence[Result], methods: Sequence[str], name: str, when: str) -> list[str]:
    shares = []
    for method in methods:
        cells = [result for result in results if result["method"] == method]
        of_kind = runs_of(cells, lambda run: (run["disturbance"], run["when"]) == (name, when))
        shares += [share([run for run in of_kind if plain(run)]), share([run for run in of_kind if beyond(run)])]
    return shares


def users_table(results: Sequence[Result]) -> str:
    """Success by user, and what the learner said."""
    head = ("user", "method", "refused sets", "done", "worst set", "false success", "recovery", "nodes", "said")
    rows = [
        (users, method, sum("refused" in cell for cell in cells), share(runs_of(cells, plain)), worst(cells),
         false_successes(runs_of(cells)), share(runs_of(cells, beyond)), sizes(cells), _said(cells))
        for (users, method), cells in grouped(results, "users", "method").items()
    ]  # fmt: skip
    return table(head, rows)


def _said(cells: Sequence[Result]) -> str:
    """The first set's notes, shortened for a table."""
    notes = cells[0].get("notes", [cells[0].get("refused", "")])
    return "<br>".join(note.replace("|", "/")[:160] for note in notes[:4])


def size_table(results: Sequence[Result]) -> str:
    """Size and time against the number of demonstrations."""
    head = ("task", "method", "demonstrations", "nodes", "with recovery", "written", "seconds")
    rows = [
        (r["scenario"], r["method"], r["demonstrations"], r["nodes"], r["nodes"] + r["nodes_recovery"],
         r["nodes_written"], f"{r['seconds']:.2f}")
        if "nodes" in r else (r["scenario"], r["method"], r["demonstrations"], "refused", "", "", "")
        for r in results
    ]  # fmt: skip
    return table(head, rows)


def calibration_table(results: Sequence[Result]) -> str:
    """How often the chosen frame is the script's, by how sure the learner was of it."""
    frames = [frame for result in results for frame in result.get("frames", ())]
    head = ("certainty", "actions", "right", "right or as good", "mean certainty")
    rows = []
    for low, high in ((0.0, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 0.99), (0.99, 1.01)):
        within = [frame for frame in frames if low <= frame["certainty"] < high]
        if within:
            right = sum(frame["right"] for frame in within) / len(within)
            mean = sum(frame["certainty"] for frame in within) / len(within)
            as_good = sum(frame["right"] or frame["as_good"] for frame in within) / len(within)
            rows.append((f"{low:g} to {min(high, 1.0):g}", len(within),
                         *(f"{100 * part:.1f} %" for part in (right, as_good, mean))))  # fmt: skip
    return table(head, rows)


def exceptions(results: Sequence[Result], below: float = 0.95) -> str:
    """The sets of demonstrations below the bar, each with its first failure."""
    lines = []
    for result in results:
        runs = runs_of([result], plain)
        failed = [run for run in runs if run["verdict"] != "done"]
        if "refused" in result:
            lines.append(f"- {name_of(result)}: refused: {result['refused']}")
        elif runs and 1 - len(failed) / len(runs) < below:
            first = failed[0]
            reasons = "; ".join(first["last_reasons"][:2]) or "no failing action"
            lines.append(
                f"- {name_of(result)}: {len(runs) - len(failed)} of {len(runs)} done; seed {first['seed']} "
                f"({first['disturbance']}, {first['when']}): {first['verdict']}; {reasons}"
            )
    return "\n".join(lines) or "None."


def name_of(result: Result) -> str:
    """A set of demonstrations in words."""
    return (
        f"{result['scenario']}, {result['users']}, {result['method']}, {result['demonstrations']} demonstrations, "
        f"set {result['number']}"
    )

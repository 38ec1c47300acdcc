"""The artifact store: immutable versions of each task's tree, and aliases that move.

Bytes lie in files named by their SHA-256 below `objects/`: the tree as canonical JSON, as BehaviorTree.CPP XML, and the
manifest. What belongs together stands in a database (SQLite in the store's folder, or any other that SQLAlchemy
reaches): a row per version, a row per alias, a row per change, which is what served stores announce, and what is
doubted of each version and who approved it (`storage.standing`).
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Final, TypeVar

import sqlalchemy as sa
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from learner.errors import LearnerError
from learner.model import Tree, check_alias, check_name
from storage import standing
from storage.btcpp import from_xml, to_xml
from storage.errors import (
    AliasRefusedError,
    DamagedError,
    DoubtfulError,
    ManifestRefusedError,
    NotStoredError,
    StorageError,
    StorageUnavailableError,
)
from storage.objects import Objects
from storage.schema import ALIASES, CHANGES, METADATA, VERSIONS
from storage.standing import Standing, standing_of

Result = TypeVar("Result")

CONTRACT: Final = "1"
LATEST: Final = "latest"
PRODUCTION: Final = "production"
DOUBTFUL: Final = "doubtful"
ATTEMPTS: Final = 50
BUSY_S: Final = 30.0
"""How long a writer waits for another one's transaction on SQLite."""
READING: Final = "reading"
SCHEMA_LOCK: Final = 8420
OWN_FACTS: Final = (
    "aliases",
    "contract",
    "created",
    "digest",
    "frames",
    "leaves",
    "nodes",
    "nodes_recovery",
    "nodes_written",
    "objects",
    "task",
    "version",
    "vocabulary",
    "xml_sha256",
)
LATER_FACTS: Final = ("leaves", "vocabulary")
"""Manifests that earlier versions wrote do not state these."""
EXPECTED_FACTS: Final = ("base_frame", "end_effector_frame", "lineage", "metrics")
"""What a manifest always has, null where the publisher does not know it."""


@dataclass(frozen=True)
class Published:
    """What publishing a tree came to: `new` is False where an equal tree was there, whose version this is."""

    version: int
    digest: str
    new: bool


@dataclass(frozen=True)
class Artifact:
    """One version of a task's tree, its bytes verified when they were read; `aliases` are the names that point to it
    now, and `standing` is what is doubted of it now. What they hold is parsed when it is asked for.
    """

    task: str
    version: int
    digest: str
    xml: str
    tree_json: str
    manifest_json: str
    aliases: tuple[str, ...]
    standing: Standing

    @cached_property
    def tree(self) -> Tree:
        """The tree. Raises DamagedError where the database names another file as it."""
        try:
            return Tree.from_json(self.tree_json)
        except LearnerError as error:
            raise self._confused(error) from error

    @cached_property
    def manifest(self) -> Mapping[str, Any]:
        """The manifest as it was published. Raises DamagedError where the database names another file as it."""
        try:
            document = json.loads(self.manifest_json)
        except ValueError as error:
            raise self._confused(error) from error
        if not isinstance(document, dict):
            raise self._confused(ValueError("the manifest is no object"))
        return document

    @property
    def served_json(self) -> str:
        """The manifest with the standing, as canonical JSON: what a controller judges by."""
        try:
            return _served(self.manifest_json, canonical(self.standing.to_data()))
        except (TypeError, ValueError) as error:
            raise self._confused(error) from error

    def _confused(self, error: Exception) -> DamagedError:
        return DamagedError(f"the store's database confuses the files of {self.task}@{self.version}: {error}")


@dataclass(frozen=True)
class Change:
    """Something that happened in the store: `event` is 'published', 'alias', or 'unalias' where one was taken away."""

    serial: int
    stamp_ns: int
    task: str
    event: str
    version: int
    alias: str | None
    digest: str


class ArtifactStore:
    """The store in the folder `root`, its metadata in `url` (SQLAlchemy) or else in `root/store.sqlite`.

    Nothing is created before something is published. A context manager: leaving it closes the database. Any number
    of processes may publish and read at once; what is read is hashed, and again whenever its file has changed.
    """

    def __init__(self, root: Path, url: str | None = None) -> None:
        self.root = Path(root)
        self._database = self.root / "store.sqlite"
        self._by_url = bool(url)
        self._objects = Objects(self.root / "objects")
        self._prepared = False
        try:
            self._engine = _engine(url or f"sqlite:///{self._database}")
        except (SQLAlchemyError, ImportError) as error:
            raise StorageUnavailableError(f"the store's database URL is refused: {_first_line(error)}") from error

    def __enter__(self) -> ArtifactStore:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the database's connections."""
        self._engine.dispose()

    def publish(self, task: str, tree: Tree, facts: Mapping[str, Any]) -> Published:
        """Store `tree` as the next version of `task`, with a manifest of `facts` and what follows from the tree.

        A tree that equals any stored version of the task, not only the newest, makes no new version: a version *is*
        a tree, and its manifest stays the one it was first published with. No alias moves.

        Raises NameRefusedError, ManifestRefusedError for facts that are not JSON or not the publisher's to state, and
        WrittenTreeError for a tree that the contract refuses.
        """
        check_name("task", task)
        _check_facts(facts)
        tree = Tree.from_json(tree.to_json())  # 0 and 0.0 are one number, and one text
        xml = to_xml(tree)
        return self._until_won(lambda: self._try_to_publish(task, tree, xml, facts))

    def alias(self, task: str, name: str, version: int) -> bool:
        """Let the alias `name` point to `version`. False if it does already.

        Raises NotStoredError, and AliasRefusedError for any alias but `doubtful` where the version is doubtful, or was
        never judged and its manifest's certificate holds a counterexample: such a tree is not for use until a person
        approves it.
        """
        check_alias(name)
        return self._until_won(lambda: self._try_to_alias(task, name, version))

    def judge(self, task: str, version: int, reasons: Sequence[str], chosen_ns: int) -> None:
        """Write why a version is doubtful, as its learner found it now, and let `latest` or `doubtful` point to it.

        Without reasons, or where a person approved them all, it becomes `latest`, but never from demonstrations that
        were chosen (at `chosen_ns`, since the epoch) before those of the present one: a learner that was slow sets
        nothing back. With reasons it becomes `doubtful`; where it was `latest`, the last good one before it is again.
        Raises NotStoredError.
        """
        self._until_won(lambda: self._try_to_judge(task, version, reasons, chosen_ns))

    def approve(self, task: str, ref: str | int, by: str) -> tuple[int, Standing]:
        """Somebody takes the doubts of a version on: it is `latest` then, unless a newer one is. Who and when is kept.

        The version, and its standing before. Raises NotStoredError, NameRefusedError for a name that is none, and
        AliasRefusedError where nothing is doubted.
        """
        check_name("user", by)
        return self._until_won(lambda: self._try_to_approve(task, ref, by))

    def get(self, task: str, ref: str | int | None = None) -> Artifact:
        """A version by its number or an alias; without `ref` production if set, else latest, else the newest.

        Raises NotStoredError, DoubtfulError where without `ref` there is nothing but a doubtful one, and DamagedError
        if a stored byte has changed.
        """
        with self._reading() as connection:
            row, aliases = self._find(connection, task, ref)
            stands = standing_of(connection, task, row.version)
        name = f"{task}@{row.version}"
        return Artifact(
            task=task,
            version=row.version,
            digest=row.digest,
            xml=self._objects.load(row.xml_sha256, f"the XML of {name}"),
            tree_json=self._objects.load(row.digest, f"the tree of {name}"),
            manifest_json=self._objects.load(row.manifest_sha256, f"the manifest of {name}"),
            aliases=tuple(sorted(alias for alias, version in aliases.items() if version == row.version)),
            standing=stands,
        )

    def tasks(self) -> list[dict[str, Any]]:
        """Each task with its newest version, that one's digest, and its aliases: what `GET /v1/tasks` answers."""
        with self._reading() as connection:
            query = sa.select(VERSIONS).order_by(VERSIONS.c.task, VERSIONS.c.version)
            newest = {row.task: row for row in connection.execute(query)}
            return [
                {
                    "task": task,
                    "version": row.version,
                    "digest": row.digest,
                    "aliases": self._aliases(connection, task),
                }
                for task, row in newest.items()
            ]

    def versions(self, task: str) -> list[dict[str, Any]]:
        """The versions of a task, newest first, each with digest, created, sizes and aliases. Raises NotStoredError."""
        with self._reading() as connection:
            rows, aliases = self._rows(connection, task), self._aliases(connection, task)
            return [
                self._summary(rows[version], aliases) | standing_of(connection, task, version).to_data()
                for version in reversed(rows)
            ]

    def aliases(self, task: str) -> dict[str, int]:
        """The version that each alias of a task points to. Raises NotStoredError."""
        with self._reading() as connection:
            self._rows(connection, task)
            return self._aliases(connection, task)

    def changes(self, after: int = 0) -> list[Change]:
        """What happened in the store since the change with the serial `after`, whichever process did it."""
        with self._reading() as connection:
            query = sa.select(CHANGES).where(CHANGES.c.serial > after).order_by(CHANGES.c.serial)
            return [Change(**row._mapping) for row in connection.execute(query)]

    def last_change(self) -> int:
        """The serial of the newest change, 0 if there is none."""
        with self._reading() as connection:
            return int(connection.execute(sa.select(sa.func.max(CHANGES.c.serial))).scalar() or 0)

    def verify(self, task: str, ref: str | int | None = None) -> Artifact:
        """Hash everything of a version again, validate its XML, and compare all of it with the manifest.

        Raises NotStoredError, and DamagedError that names what does not fit.
        """
        self._objects.forget()
        artifact = self.get(task, ref)
        name, manifest = f"{task}@{artifact.version}", artifact.manifest
        try:
            written = from_xml(artifact.xml)
        except StorageError as error:
            raise DamagedError(f"the XML of {name} is refused: {error}") from error
        expected = _derived(task, artifact.version, artifact.tree, artifact.xml)
        expected = {key: value for key, value in expected.items() if key in manifest or key not in LATER_FACTS}
        wrong = sorted(key for key, value in expected.items() if manifest.get(key) != value)
        if written != artifact.tree:
            raise DamagedError(f"the XML of {name} is another tree than its JSON")
        if wrong:
            raise DamagedError(f"the manifest of {name} states a false {', '.join(wrong)}")
        return artifact

    def _try_to_publish(self, task: str, tree: Tree, xml: str, facts: Mapping[str, Any]) -> Published:
        with self._writing() as connection:
            query = sa.select(VERSIONS).where(VERSIONS.c.task == task).order_by(VERSIONS.c.version)
            rows = connection.execute(query).all()
            for row in rows:
                if row.digest == tree.digest:
                    return Published(row.version, row.digest, False)
            version = 1 + max((row.version for row in rows), default=0)
            manifest = canonical(_manifest(_derived(task, version, tree, xml), facts))
            hashes = {
                name: self._objects.save(text) for name, text in (("xml_sha256", xml), ("manifest_sha256", manifest))
            }
            self._objects.save(tree.to_json())
            connection.execute(VERSIONS.insert().values(task=task, version=version, digest=tree.digest, **hashes))
            _record(connection, task, "published", version, None, tree.digest)
        return Published(version, tree.digest, True)

    def _try_to_alias(self, task: str, name: str, version: int) -> bool:
        with self._writing() as connection:
            row, aliases = self._find(connection, task, version)
            if aliases.get(name) == version:
                return False
            if name != DOUBTFUL:
                self._check_fit(connection, row)
            return self._point(connection, task, name, version)

    def _try_to_judge(self, task: str, version: int, reasons: Sequence[str], chosen_ns: int) -> None:
        with self._writing() as connection:
            self._resolve(connection, task, version)
            standing.judge(connection, task, version, reasons, chosen_ns)
            aliases = self._aliases(connection, task)
            if standing_of(connection, task, version).doubtful:
                self._point(connection, task, DOUBTFUL, version)
                if aliases.get(LATEST) == version:
                    self._point(connection, task, LATEST, self._last_good(connection, task))
                return
            if aliases.get(DOUBTFUL) == version:
                self._point(connection, task, DOUBTFUL, None)
            present = aliases.get(LATEST)
            newer = standing_of(connection, task, present).chosen_ns if present else None
            if newer is None or newer <= chosen_ns:
                self._point(connection, task, LATEST, version)

    def _try_to_approve(self, task: str, ref: str | int, by: str) -> tuple[int, Standing]:
        with self._writing() as connection:
            version = self._resolve(connection, task, ref)
            before = standing_of(connection, task, version)
            if not before.doubtful:
                raise AliasRefusedError(f"nothing is doubted of {task}@{version}; there is nothing to approve")
            standing.approve(connection, task, version, by, before.doubtful)
            aliases = self._aliases(connection, task)
            if aliases.get(DOUBTFUL) == version:
                self._point(connection, task, DOUBTFUL, None)
            if aliases.get(LATEST, 0) < version:
                self._point(connection, task, LATEST, version)
        return version, before

    def _point(self, connection: sa.Connection, task: str, name: str, version: int | None) -> bool:
        """Let an alias point to a version, or take it away (None), and record that. False if nothing changes."""
        present = self._aliases(connection, task).get(name)
        if present == version:
            return False
        where = (ALIASES.c.task == task) & (ALIASES.c.name == name)
        if version is None:
            connection.execute(ALIASES.delete().where(where))
        elif present is None:
            connection.execute(ALIASES.insert().values(task=task, name=name, version=version))
        else:
            connection.execute(ALIASES.update().where(where).values(version=version))
        about = version or present
        assert about is not None  # not both are None: they differ
        row = connection.execute(_version(task, about)).one()
        _record(connection, task, "alias" if version else "unalias", about, name, row.digest)
        return True

    def _last_good(self, connection: sa.Connection, task: str) -> int | None:
        """The version that was `latest` last of those of which nothing is doubted; None if there is none."""
        was = sa.select(CHANGES.c.version).where(CHANGES.c.task == task, CHANGES.c.alias == LATEST)
        earlier = connection.execute(was.order_by(CHANGES.c.serial.desc())).scalars()
        return next((int(v) for v in earlier if not standing_of(connection, task, int(v)).doubtful), None)

    def _check_fit(self, connection: sa.Connection, row: sa.Row[Any]) -> None:
        name, stands = f"{row.task}@{row.version}", standing_of(connection, row.task, row.version)
        if stands.doubtful:
            raise AliasRefusedError(
                f"{name} is doubtful and gets no other alias until `treewright approve {name} --by NAME`: "
                f"{stands.doubtful[0]}"
            )
        if stands.chosen_ns is None and self._counterexample(row):
            raise AliasRefusedError(f"{name} has a counterexample in its certificate; learn it again")

    def _counterexample(self, row: sa.Row[Any]) -> bool:
        certificate = self._manifest(row).get("certificate")
        return isinstance(certificate, dict) and bool(certificate.get("counterexample"))

    def _resolve(self, connection: sa.Connection, task: str, ref: str | int | None) -> int:
        return int(self._find(connection, task, ref)[0].version)

    def _find(self, connection: sa.Connection, task: str, ref: str | int | None) -> tuple[sa.Row[Any], dict[str, int]]:
        """The row of a version, and all aliases of its task."""
        rows, aliases = self._rows(connection, task), self._aliases(connection, task)
        if ref is None and not {PRODUCTION, LATEST} & set(aliases) and DOUBTFUL in aliases:
            raise DoubtfulError(task, aliases[DOUBTFUL])
        if ref is None:
            return rows[aliases.get(PRODUCTION, aliases.get(LATEST, max(rows)))], aliases
        if isinstance(ref, str) and ref in aliases:
            return rows[aliases[ref]], aliases
        number = int(ref) if re.fullmatch("[0-9]{1,9}", str(ref), re.ASCII) else 0
        if number not in rows:
            raise NotStoredError(f"version of {task}", ref, [*rows, *sorted(aliases)])
        return rows[number], aliases

    def _rows(self, connection: sa.Connection, task: str) -> dict[int, sa.Row[Any]]:
        """The versions of a task, oldest first. Raises NotStoredError, NameRefusedError."""
        check_name("task", task)
        query = sa.select(VERSIONS).where(VERSIONS.c.task == task).order_by(VERSIONS.c.version)
        rows = {int(row.version): row for row in connection.execute(query)}
        if not rows:
            known = sa.select(VERSIONS.c.task).distinct().order_by(VERSIONS.c.task)
            raise NotStoredError("tree", task, connection.execute(known).scalars())
        return rows

    def _aliases(self, connection: sa.Connection, task: str) -> dict[str, int]:
        query = sa.select(ALIASES.c.name, ALIASES.c.version).where(ALIASES.c.task == task).order_by(ALIASES.c.name)
        return {row.name: int(row.version) for row in connection.execute(query)}

    def _summary(self, row: sa.Row[Any], aliases: Mapping[str, int]) -> dict[str, Any]:
        """What a list says of a version; of one whose manifest is damaged, what the database knows, and the damage."""
        damage: dict[str, Any] = {}
        try:
            manifest = self._manifest(row)
        except DamagedError as error:
            manifest, damage = {"version": row.version, "digest": row.digest}, {"damaged": str(error)}
        shown = {key: manifest.get(key) for key in ("version", "digest", "created", "nodes", "nodes_recovery")}
        return shown | {"aliases": sorted(name for name, version in aliases.items() if version == row.version)} | damage

    def _manifest(self, row: sa.Row[Any]) -> dict[str, Any]:
        name = f"{row.task}@{row.version}"
        text = self._objects.load(row.manifest_sha256, f"the manifest of {name}")
        try:
            return dict(json.loads(text))
        except (TypeError, ValueError) as error:
            raise DamagedError(f"the store's database names a file that is no manifest of {name}: {error}") from error

    @contextmanager
    def _reading(self) -> Iterator[sa.Connection]:
        """A connection that sees one state; an empty database in memory where nothing was ever published."""
        with self._failures():
            if self._by_url:
                self._prepare()
            elif not self._is_there():
                with sa.create_engine("sqlite://").begin() as connection:
                    METADATA.create_all(connection)
                    yield connection
                return
            with self._engine.execution_options(**{READING: True}).connect() as connection:
                yield connection

    def _is_there(self) -> bool:
        """Whether the database holds our tables: its file may be there while another process is about to make them."""
        if not self._prepared and self._database.exists() and sa.inspect(self._engine).has_table(CHANGES.name):
            self._prepare()  # one that an earlier version made lacks the newest tables
        return self._prepared and self._database.exists()

    @contextmanager
    def _writing(self) -> Iterator[sa.Connection]:
        with self._failures():
            self._prepare()
            with self._engine.begin() as connection:
                if self._engine.dialect.name == "postgresql":
                    # As on SQLite: serials of changes then become visible in their order.
                    connection.execute(sa.text("LOCK TABLE changes IN EXCLUSIVE MODE"))
                yield connection

    def _prepare(self) -> None:
        if not self._prepared:
            self.root.mkdir(parents=True, exist_ok=True)
            with self._engine.begin() as connection:
                if self._engine.dialect.name == "postgresql":
                    # CREATE TABLE IF NOT EXISTS is no protection against another process that does the same.
                    connection.execute(sa.text(f"SELECT pg_advisory_xact_lock({SCHEMA_LOCK})"))
                METADATA.create_all(connection)
            self._prepared = True

    @contextmanager
    def _failures(self) -> Iterator[None]:
        try:
            yield
        except IntegrityError:
            raise
        except SQLAlchemyError as error:
            raise StorageUnavailableError(f"the store {self.root} cannot be used: {_first_line(error)}") from error
        except OSError as error:
            raise StorageUnavailableError(f"the store {self.root} cannot be used: {error}") from error

    def _until_won(self, attempt: Callable[[], Result]) -> Result:
        """Try again where another publisher took the same version number meanwhile."""
        for count in range(ATTEMPTS):
            try:
                return attempt()
            except IntegrityError:
                time.sleep(0.005 * count)
        raise StorageUnavailableError(f"the store {self.root} is written by too many at once; try again")


def canonical(document: Mapping[str, Any]) -> str:
    """Canonical JSON: keys sorted, no spaces, ASCII. Raises ManifestRefusedError for what is not JSON."""
    try:
        return json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ManifestRefusedError(f"the facts about a tree are not JSON: {error}") from error


@lru_cache(maxsize=64)
def _served(manifest_json: str, standing_json: str) -> str:
    """Remembered, for a manifest is read far more often than it is judged."""
    return canonical({**json.loads(manifest_json), **json.loads(standing_json)})


@lru_cache(maxsize=64)
def sha256_of(text: str) -> str:
    """The SHA-256 of a text, in hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def _check_facts(facts: Mapping[str, Any]) -> None:
    if own := sorted(set(facts) & set(OWN_FACTS)):
        raise ManifestRefusedError(f"the store itself states {', '.join(own)}; leave it out of the facts")
    canonical(facts)


def _derived(task: str, version: int, tree: Tree, xml: str) -> dict[str, Any]:
    return {
        "contract": CONTRACT,
        "digest": tree.digest,
        "frames": sorted(tree.frames()),
        "nodes": tree.nodes,
        "leaves": sorted(tree.leaves),
        "nodes_recovery": tree.nodes_recovery,
        "nodes_written": tree.nodes_written,
        "objects": sorted(tree.objects()),
        "task": task,
        "version": version,
        "vocabulary": tree.vocabulary,
        "xml_sha256": sha256_of(xml),
    }


def _manifest(derived: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    created = datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return {**dict.fromkeys(EXPECTED_FACTS), **facts, **derived, "created": created}


def _version(task: str, version: int) -> sa.Select[Any]:
    return sa.select(VERSIONS).where(VERSIONS.c.task == task, VERSIONS.c.version == version)


def _record(connection: sa.Connection, task: str, event: str, version: int, alias: str | None, digest: str) -> None:
    values = {"task": task, "event": event, "version": version, "alias": alias, "digest": digest}
    connection.execute(CHANGES.insert().values(stamp_ns=time.time_ns(), **values))


def _engine(url: str) -> sa.Engine:
    if not url.startswith("sqlite"):
        return sa.create_engine(url, pool_pre_ping=True)
    engine = sa.create_engine(url, connect_args={"timeout": BUSY_S})

    @sa.event.listens_for(engine, "connect")
    def _on_connect(connection: Any, _: object) -> None:
        connection.isolation_level = None
        connection.execute("PRAGMA foreign_keys = ON")

    @sa.event.listens_for(engine, "begin")
    def _on_begin(connection: sa.Connection) -> None:
        # Writers queue from their first look on, so that none decides on what another is about to change.
        reading = connection.get_execution_options().get(READING)
        connection.exec_driver_sql("BEGIN" if reading else "BEGIN IMMEDIATE")

    return engine


def _first_line(error: BaseException) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]

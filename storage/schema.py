"""The tables of the artifact store: versions, aliases, changes, what is doubted of a version, and who approved it."""

from __future__ import annotations

from typing import Final

import sqlalchemy as sa

METADATA: Final = sa.MetaData()
VERSIONS: Final = sa.Table(
    "versions",
    METADATA,
    sa.Column("task", sa.String(64), primary_key=True),
    sa.Column("version", sa.Integer, primary_key=True),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("manifest_sha256", sa.String(64), nullable=False),
    sa.Column("xml_sha256", sa.String(64), nullable=False),
    # One version a tree: what keeps racing publishers of one tree from making two.
    sa.UniqueConstraint("task", "digest"),
)
ALIASES: Final = sa.Table(
    "aliases",
    METADATA,
    sa.Column("task", sa.String(64), primary_key=True),
    sa.Column("name", sa.String(64), primary_key=True),
    sa.Column("version", sa.Integer, nullable=False),
    sa.ForeignKeyConstraint(["task", "version"], ["versions.task", "versions.version"]),
)
CHANGES: Final = sa.Table(
    "changes",
    METADATA,
    sa.Column("serial", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("stamp_ns", sa.BigInteger, nullable=False),
    sa.Column("task", sa.String(64), nullable=False),
    sa.Column("event", sa.String(16), nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("alias", sa.String(64)),
    sa.Column("digest", sa.String(64), nullable=False),
    sqlite_autoincrement=True,
)
STANDINGS: Final = sa.Table(
    "standings",
    METADATA,
    sa.Column("task", sa.String(64), primary_key=True),
    sa.Column("version", sa.Integer, primary_key=True),
    sa.Column("reasons", sa.Text, nullable=False),
    sa.Column("chosen_ns", sa.BigInteger, nullable=False),
    sa.ForeignKeyConstraint(["task", "version"], ["versions.task", "versions.version"]),
)
"""What was doubted of a version when it was learned last (a JSON list of sentences), and when its demonstrations were
chosen then."""
APPROVALS: Final = sa.Table(
    "approvals",
    METADATA,
    sa.Column("serial", sa.Integer, primary_key=True, autoincrement=True),
    sa.Column("task", sa.String(64), nullable=False),
    sa.Column("version", sa.Integer, nullable=False),
    sa.Column("by", sa.String(64), nullable=False),
    sa.Column("stamp_ns", sa.BigInteger, nullable=False),
    sa.Column("reasons", sa.Text, nullable=False),
    sa.ForeignKeyConstraint(["task", "version"], ["versions.task", "versions.version"]),
    sqlite_autoincrement=True,
)
"""Who took which doubts of a version on, and when."""

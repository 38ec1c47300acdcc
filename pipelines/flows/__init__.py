"""The Prefect flows, the only home of Prefect.

    recordings ──▶ ingest ──▶ lake ──▶ learn ──▶ artifact store         refresh: ingest, then learn what changed
                     │                   │
                 quarantine      clusters, groups, tree                 shown as Prefect artifacts

A task is a few lines around a plain function of `pipelines.steps`.
"""

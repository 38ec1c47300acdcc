"""The Prefect flows, the only home of Prefect.

    recordings ──▶ ingest ──▶ lake ──▶ learn ──▶ artifact store         refresh: ingest, then learn what changed
                     │                   │
                 quarantine     clusters, goals, tree, timings          shown as Prefect artifacts

A task is a few lines around a plain function of `pipelines.steps`, or a stage of the learner (`stages`). The service's
own runs are begun by `dispatcher`, in warm processes (`worker`, `jobs`); those that a person asks for by `deployments`.
"""

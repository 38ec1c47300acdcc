"""The plain functions that flows and commands call: ingest, learn, and what changed since. No Prefect.

stores, locks -> ingest, learn -> changes, sentences, cluster_picture. Calls go from right to left.
"""

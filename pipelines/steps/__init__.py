"""The plain functions that flows and commands call: ingest, learn, and what changed since. No Prefect.

stores -> ingest, learn -> changes. Calls go from right to left.
"""

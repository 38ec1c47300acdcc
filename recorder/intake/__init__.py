"""From the network to memory: what happens to a sample before anything is written.

receiving (every sample, on the thread that received it) calls routes (what becomes of its key: patterns, channels),
ledger (what is missing, by the account of each publisher), waiting (what waits to be written) and fence (what has come
before a request). caches asks publishers for what is missing, latched for what was there before.
"""

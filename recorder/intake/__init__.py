"""From the network to memory: what happens to a sample before anything is written.

receiving (every sample, on the thread that received it) calls ledger (what is missing), channels (their numbers) and
waiting (what waits to be written); caches asks publishers for what is missing, latched for what was there before.
"""

"""Finished recordings travel to the service that learns from them, and stay here too.

outbox knows which recordings wait and which are confirmed; carrier brings one file over HTTP, going on where it was cut
off; uploader does so for all of them on a thread of its own. Calls go from uploader to the other two.
"""

"""What holds for all tests: generated examples may take the time that a busy machine needs."""

from hypothesis import settings

settings.register_profile("treewright", deadline=None)
settings.load_profile("treewright")

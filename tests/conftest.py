"""How hypothesis runs here: the same examples every time, and no deadline, so that no test can fail for timing."""

from hypothesis import settings

settings.register_profile("labrig", deadline=None, derandomize=True)
settings.load_profile("labrig")

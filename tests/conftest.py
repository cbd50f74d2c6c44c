"""How the tests run here: hypothesis with the same examples every time and without a deadline, so that no test can fail
for timing; linear algebra with the kernels that labrig uses.
"""

from hypothesis import settings

import labrig  # noqa: F401 - chooses the kernels of OpenBLAS, which it can only do before numpy is loaded

settings.register_profile("labrig", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("labrig")

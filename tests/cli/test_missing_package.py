"""What needs a package that is not installed ends with the command that installs it."""

import pytest
from packaging.requirements import Requirement

from labrig.cli.missing_package import require_package
from labrig.errors import InputError


@pytest.mark.parametrize("package", ["rerun-sdk", "pyarrow", "mcap", "dask"])
def test_a_missing_package_is_named_with_the_versions_that_fit(package: str) -> None:
    """It is wrong input, not a bug of labrig; the line installs a version that labrig was made for."""
    with pytest.raises(InputError, match=f"--option needs the package {package}, which") as refused:
        require_package("no_such_module", package, "--option")
    wanted = Requirement(refused.value.hint.removeprefix("pip install '").removesuffix("'"))
    assert (wanted.name, bool(wanted.specifier), wanted.marker) == (package, True, None)
    require_package("json", package, "--option")

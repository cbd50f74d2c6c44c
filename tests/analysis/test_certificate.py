"""What a certificate says in words, on its page and in the terminal."""

import pytest

from labrig.analysis.certificate import describe_half
from tests.experiments.insertion.test_page import make_certificate


@pytest.mark.parametrize(
    ("between", "said"),
    [
        ((-1.0, -2.0), "-1 to -2"),
        ((-1.0, None), "beyond -1"),
        ((None, -2.0), "before -2"),
        ((None, None), "-"),
    ],
)
def test_half_of_the_repetitions_arrive_between_two_values_that_are_sure(
    between: tuple[float | None, float | None], said: str
) -> None:
    """As far as either is known."""
    margin = make_certificate().margins[0].model_copy(update={"half_between": between})
    assert describe_half(margin, lambda value: "-" if value is None else f"{value:g}") == said

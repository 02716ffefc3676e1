import pytest
from pydantic import Field, model_validator

from leglab.base.errors import LeglabError
from leglab.base.settings import Configuration, validate_configuration


class Gains(Configuration):
    proportional: float = Field(gt=0)
    low: float = 0.0
    high: float = 1.0

    @model_validator(mode="after")
    def _ordered(self):
        if self.low > self.high:
            raise ValueError(f"low ({self.low}) must not exceed high ({self.high})")
        return self


class Empty(Configuration):
    pass


def test_good_values():
    gains = validate_configuration(Gains, {"proportional": 2}, "controller 'pd'")
    assert gains.proportional == 2.0
    assert validate_configuration(Empty, None, "controller 'pd'") == Empty()


@pytest.mark.parametrize(
    ("model", "values", "message"),
    [
        (Gains, {}, "controller 'pd' needs the setting 'proportional'"),
        (
            Gains,
            {"proportional": -1},
            "setting 'proportional' is -1: input should be greater than 0",
        ),
        (
            Gains,
            {"proportional": "x"},
            "setting 'proportional' is 'x': input should be a valid num",
        ),
        (Gains, {"proportional": float("nan")}, "'proportional' is nan: input should be a finite"),
        (Gains, {"proportional": 1, "hgih": 2}, "'hgih': choose one of .* did you mean 'high'"),
        (Gains, {"proportional": 1, "low": 2}, r"controller 'pd': low \(2.0\) must not exceed"),
        (Empty, {"gain": 1}, "controller 'pd' has no settings, but 'gain' was given"),
    ],
)
def test_bad_values_give_one_line(model, values, message):
    with pytest.raises(LeglabError, match=message) as caught:
        validate_configuration(model, values, "controller 'pd'")
    assert "\n" not in str(caught.value)

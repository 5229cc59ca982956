"""Quantities of a scene: types with units and limits, and faults that state the violated rule."""

from __future__ import annotations

import math
import threading
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    field_validator,
)
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

MAX_PIXELS = 2**28
MIN_LENGTH_MM, MAX_LENGTH_MM = 1e-6, 1e9
SMALLEST_QUATERNION = 1e-6  # length below which a quaternion has no direction
MAX_LISTED = 4096  # largest number of entries of an array in place of a list

Vector = tuple[float, float, float]
Location = tuple[str | int, ...]
"""Location of a key or table, such as ("object", 0, "motion", "velocity")."""
Fault = tuple[Location, PydanticCustomError | str, Any]
"""Location of a fault, the violated rule or an error from `fault`, and the invalid value."""


def as_python(value: Any) -> Any:
    """NumPy numbers and small arrays converted to Python numbers and lists; other values, such as images, unchanged."""
    if isinstance(value, np.longdouble):
        return float(value)
    return value.tolist() if isinstance(value, np.generic | np.ndarray) and value.size <= MAX_LISTED else value


def fault(rule: str, got: str | None = None) -> PydanticCustomError:
    """Build the error that states a violated rule, "must be ..."; got: shown in place of an input that is too long."""
    context = {"rule": rule} if got is None else {"rule": rule, "got": got}
    return PydanticCustomError("rule", "{rule}", context)


def refuse_if(wrong: Callable[[Any], bool], rule: str, got: str | None = None) -> Callable[[Any], Any]:
    """Validator that rejects values for which `wrong` is true; rule, got: as for `fault`."""

    def check(value: Any) -> Any:
        if wrong(value):
            raise fault(rule, got)
        return value

    return check


def only_with(selector: str, homes: Mapping[str, tuple[str, ...]]) -> Any:
    """Validator for keys that are allowed only with some values of another key, which precedes them in the table.

    selector: name of the other key in messages, such as "psf.model"; homes: for each key, the values that allow it.
    """

    def check(value: Any, info: ValidationInfo) -> Any:
        values = homes[str(info.field_name)]
        if (chosen := info.data.get(selector.rpartition(".")[2], values[0])) not in values:
            listed = " or ".join(f'"{each}"' for each in values)
            raise fault(f'belongs to {selector} = {listed}, not "{chosen}"')
        return value

    return field_validator(*homes)(check)


def instead_of(**others: str) -> Any:
    """Validator for keys that cannot be given together with another, which the model declares before them. others: this
    other key, by key.
    """

    def check(value: Any, info: ValidationInfo) -> Any:
        other = others[str(info.field_name)]
        if value is not None and info.data.get(other, "refused") is not None:  # "refused" if the other key was rejected
            raise fault(f"give {other} or {info.field_name}, not both")
        return value

    return field_validator(*others)(check)


def raise_faults(*faults: Fault) -> None:
    """Raise one error for all faults, if there are any."""
    if faults:
        errors = ((loc, fault(rule) if isinstance(rule, str) else rule, value) for loc, rule, value in faults)
        details = [InitErrorDetails(type=error, loc=loc, input=value) for loc, error, value in errors]
        raise ValidationError.from_exception_data("scene", details)


@dataclass(frozen=True)
class Within:
    """Constraint on a number: finite and between `low` and `high`, in `unit`.

    ends: a bracket for each limit, square if the limit itself is allowed. infinite: True if the number may also be
    infinite: inf, or "inf" if a file format has no such number.
    """

    low: float
    high: float
    unit: str = ""
    ends: Literal["[]", "[)", "()"] = "[]"
    infinite: bool = False

    def check(self, value: float) -> float:
        """Return the value if it satisfies the constraint; otherwise raise the fault that states the constraint."""
        unit = f" {self.unit}" if self.unit else ""
        if self.infinite and value == math.inf:
            return value
        if isinstance(value, float) and not math.isfinite(value):
            raise fault("must be a finite number")
        above = self.low <= value if self.ends[0] == "[" else self.low < value
        if above and (value <= self.high if self.ends[1] == "]" else value < self.high):
            return value
        if 0.0 < self.low < 1.0 and value <= 0.0:
            raise fault(f"must be greater than 0{unit}")
        excluded = {"[]": "", "[)": f", {self.high:.7g} excluded", "()": ", ends excluded"}[self.ends]
        raise fault(f"must be between {self.low:.7g} and {self.high:.7g}{unit}{excluded}")

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        number = core_schema.no_info_before_validator_function(as_python, handler(source))
        checked = core_schema.no_info_after_validator_function(self.check, number)
        if not self.infinite:
            return checked
        written = core_schema.plain_serializer_function_ser_schema(
            lambda value: "inf" if value == math.inf else value, when_used="json"
        )
        return core_schema.no_info_before_validator_function(
            lambda value: math.inf if type(value) is str and value == "inf" else value, checked, serialization=written
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        low = "minimum" if self.ends[0] == "[" else "exclusiveMinimum"
        high = "maximum" if self.ends[1] == "]" else "exclusiveMaximum"
        limited = {**handler(schema), low: self.low, high: self.high}
        return {"anyOf": [limited, {"const": "inf", "type": "string"}]} if self.infinite else limited


def _list_of(count: int, what: str) -> Callable[[Any], Any]:
    """Function that converts a list or array of `count` entries to a tuple, because file formats have only lists."""

    def convert(value: Any) -> Any:
        listed = as_python(value)
        if isinstance(listed, list | tuple) and len(listed) == count:
            return tuple(listed)
        raise fault(f"must be a list of {count} {what}")

    return convert


def array_of_tables(header: str, what: str, most: int, least: int = 0) -> BeforeValidator:
    """Constraint on an array of tables, [[header]] in a file: the number of tables; the array becomes a tuple.

    what: name of the tables in messages.
    """

    def convert(value: Any) -> Any:
        value = as_python(value)
        if not isinstance(value, list | tuple):
            raise fault(f"must be an array of tables, [[{header}]]")
        if not least <= len(value) <= most:
            count = f"{least} to {most}" if least else f"at most {most}"
            raise fault(f"must hold {count} {what}", got=str(len(value)))
        return tuple(value)

    return BeforeValidator(convert)


def _count_or_auto(value: Any) -> Any:
    """Reject any value but a number of samples or "auto"."""
    value = as_python(value)
    if (type(value) is int and 1 <= value <= 4096) or (type(value) is str and value == "auto"):
        return value
    raise fault('must be an integer between 1 and 4096, or "auto"')


_single_line = refuse_if(
    lambda text: any(unicodedata.category(character) in ("Cc", "Cs") for character in text),
    "must be one line of text without control characters",
)
_increasing = refuse_if(lambda ends: ends[0] >= ends[1], "lower bound must be less than the upper bound")
_not_zero = refuse_if(
    lambda vector: max(map(abs, vector)) < MIN_LENGTH_MM,
    f"must not be the zero vector (one component of {MIN_LENGTH_MM:g} at least)",
)
_not_small = refuse_if(
    lambda quaternion: math.hypot(*quaternion) < SMALLEST_QUATERNION,
    f"must not be zero (length of {SMALLEST_QUATERNION:g} at least)",
)
_few_enough = refuse_if(lambda size: size[0] * size[1] > MAX_PIXELS, f"must have at most {MAX_PIXELS} pixels in all")
_surface = refuse_if(lambda coefficients: not any(coefficients[:9]), "must not all be 0, or all but a000")
Pair, Triple = (BeforeValidator(_list_of(count, "numbers")) for count in (2, 3))
Flag = Annotated[bool, BeforeValidator(as_python)]
Text = Annotated[str, Field(max_length=4096), AfterValidator(_single_line)]
Name = Annotated[str, Field(min_length=1, max_length=4096), AfterValidator(_single_line)]
Length = Annotated[float, Within(MIN_LENGTH_MM, MAX_LENGTH_MM, "mm")]
FocusDistance = Annotated[float, Within(MIN_LENGTH_MM, MAX_LENGTH_MM, "mm", infinite=True)]
Sides = Annotated[tuple[Length, Length], Pair]
Lengths = Annotated[tuple[Length, Length, Length], Triple]
Coordinate = Annotated[float, Within(-MAX_LENGTH_MM, MAX_LENGTH_MM, "mm")]
Point = Annotated[tuple[Coordinate, Coordinate, Coordinate], Triple]
Frequency = Annotated[float, Within(1e-6, 1e6, "Hz")]
Band = Annotated[tuple[Frequency, Frequency], AfterValidator(_increasing), Pair]
Interval = Annotated[tuple[Coordinate, Coordinate], AfterValidator(_increasing), Pair]
Bounds = Annotated[tuple[Interval, Interval, Interval], BeforeValidator(_list_of(3, "pairs [low, high]"))]
Component = Annotated[float, Within(-1e9, 1e9)]
Direction = Annotated[tuple[Component, Component, Component], AfterValidator(_not_zero), Triple]
Quaternion = Annotated[
    tuple[Component, Component, Component, Component],
    AfterValidator(_not_small),
    BeforeValidator(_list_of(4, "numbers")),
]
Angle = Annotated[float, Within(-1e9, 1e9, "deg")]
Slope = Annotated[float, Within(-1e6, 1e6, "mm per mm")]
Coefficient = Annotated[float, Within(-1e30, 1e30)]
Coefficients = Annotated[
    tuple[Coefficient, ...],
    Field(json_schema_extra={"minItems": 10, "maxItems": 10}),
    AfterValidator(_surface),
    BeforeValidator(_list_of(10, "numbers")),
]
Speed = Annotated[float, Within(-1e9, 1e9, "mm/s")]
Velocity = Annotated[tuple[Speed, Speed, Speed], Triple]
Turn = Annotated[float, Within(-1e9, 1e9, "deg/s")]
AngularVelocity = Annotated[tuple[Turn, Turn, Turn], Triple]
SpeedUp = Annotated[float, Within(-1e9, 1e9, "mm/s^2")]
Acceleration = Annotated[tuple[SpeedUp, SpeedUp, SpeedUp], Triple]
TurnUp = Annotated[float, Within(-1e9, 1e9, "deg/s^2")]
AngularAcceleration = Annotated[tuple[TurnUp, TurnUp, TurnUp], Triple]
Time = Annotated[float, Within(-1e9, 1e9, "s")]
Duration = Annotated[float, Within(1e-9, 1e9, "s")]
FNumber = Annotated[float, Within(1e-3, 1e6)]
Pixels = Annotated[int, Within(1, 65536, "px")]
Resolution = Annotated[tuple[Pixels, Pixels], AfterValidator(_few_enough), BeforeValidator(_list_of(2, "integers"))]
Samples = Annotated[Annotated[int, Within(1, 4096)] | Literal["auto"], BeforeValidator(_count_or_auto)]


_BUILDING = threading.RLock()


class Deferred:
    """Constraint on an optional section: the rules of its model, which is built at its first use."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        model, _ = get_args(source)

        def check(value: Any) -> Any:
            if value is None:
                return None
            model.model_rebuild()  # otherwise another thread could validate with a half-built model
            return model.model_validate(value)

        return core_schema.no_info_plain_validator_function(check, metadata={"source": source})

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        while schema["type"] != "function-plain":  # inside the validators of the field
            schema = schema["schema"]
        return handler(TypeAdapter(schema["metadata"]["source"]).core_schema)


class Strict(BaseModel):
    """Base of all models of a scene: no conversions, no unknown keys, no changes after validation."""

    # Most scenes have few shapes, so the validator of a shape is built at its first use. For the same reason, omitted
    # sections are created by `model_construct`: defaults need no validation.
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True, defer_build=True)

    refusal: ClassVar[Callable[[type[BaseModel], ValidationError], Exception]]
    """Makes the SceneError of a constructor; set by `clsco.scene.model`, because messages depend on all models."""

    if not TYPE_CHECKING:  # type checkers derive the arguments from the fields

        def __init__(self, /, **values: Any) -> None:
            """Raise SceneError, with one message per fault, for invalid values."""
            try:
                super().__init__(**values)
            except ValidationError as error:
                raise Strict.refusal(type(self), error) from None

        # With this attribute, which pydantic's own constructor has, this one is not called for the parts of a model.
        __init__.__pydantic_base_init__ = True

    @classmethod
    def model_rebuild(cls, **options: Any) -> bool | None:
        """pydantic's method with a lock: before pydantic 2.14, concurrent calls in threads interfere."""
        with _BUILDING:
            return super().model_rebuild(**options)

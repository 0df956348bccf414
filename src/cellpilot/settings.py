"""What every person-written section of settings is made of: the base class, and the types of the fields."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from cellpilot.errors import InputError

NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, lt=2**31)]
Pair = Annotated[tuple[Finite, Finite], Strict(False)]
Cell = Annotated[tuple[int, int, int], Strict(False)]
Floats = Annotated[tuple[Finite, ...], Strict(False)]
Paths = Annotated[tuple[Annotated[Path, Strict(False)], ...], Strict(False)]


class Settings(BaseModel):
    """Base of all sections: frozen, strict types, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    def changed(self, **changes: Any) -> Self:
        """A copy with these fields changed, all fields checked together; `InputError` naming the field that is wrong."""
        try:
            return type(self).model_validate({name: getattr(self, name) for name in type(self).model_fields} | changes)
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            field = ".".join(map(str, first["loc"])) or type(self).__name__
            if first["type"] == "extra_forbidden":
                raise InputError(f"{field} is no setting; expected one of {', '.join(type(self).model_fields)}") from None
            message = first["msg"].removeprefix("Value error, ")
            found = "" if first["type"] == "value_error" else f" is {first['input']!r}"
            raise InputError(f"{field}{found}: {message[0].lower()}{message[1:]}") from None

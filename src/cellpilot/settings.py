"""What every person-written section of settings is made of: the base class, and the types of the fields."""

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, Strict

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

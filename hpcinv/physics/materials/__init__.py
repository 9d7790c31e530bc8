"""Material laws: one file each, registered by subclassing `MaterialLaw`."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import GetJsonSchemaHandler
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import core_schema

from hpcinv.base.quantity.plugins import load_installed
from hpcinv.base.quantity.schema import KeyPath, OneOf, collected, define_in, members_of, raise_if_any
from hpcinv.physics.materials.material_law import MaterialLaw

define_in(__name__, MaterialLaw)


class OneOrByRegion(OneOf):
    """Annotation of a field that holds one member of a family, or a mapping of regions to members."""

    def choose(self, data: Any, info: core_schema.ValidationInfo[Any]) -> Any:
        entries = data.values() if isinstance(data, Mapping) else ()
        if not entries or not all(isinstance(entry, Mapping | self.family) for entry in entries):
            return super().choose(data, info)
        chosen, problems = {}, list[tuple[KeyPath, str]]()
        for region, entry in data.items():
            with collected(problems, region):
                chosen[region] = super().choose(entry, info)
        raise_if_any(problems)
        return chosen

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        single = super().__get_pydantic_json_schema__(schema, handler)
        regional = {"type": "object", "additionalProperties": single, "minProperties": 1}
        return {"oneOf": [*single["oneOf"], regional]}


Material = Annotated[MaterialLaw | Mapping[str, MaterialLaw], OneOrByRegion("law", MaterialLaw)]


def laws() -> dict[str, type[MaterialLaw]]:
    """Return every known law by name."""
    load_installed()
    return members_of(MaterialLaw, "law")


__all__ = ["Material", "MaterialLaw", "laws"]

"""Refuse query parameters that an API route does not know, as unknown fields of a body are refused."""

from fastapi import Request
from fastapi.dependencies.utils import get_flat_params
from fastapi.exceptions import RequestValidationError
from fastapi.params import Query
from fastapi.routing import APIRoute


async def known_parameters(request: Request) -> None:
    """Refuse a request whose address asks for more than its route takes: `as_off` for `as_of` is another board.

    Raises:
        RequestValidationError: A parameter is unknown.
    """
    if not request.query_params:
        return
    route = request.scope["route"]
    assert isinstance(route, APIRoute)
    told = (route.openapi_extra or {}).get("parameters", ())  # those that a route reads itself
    known = {each["name"] for each in told}
    known |= {
        it.alias for it in get_flat_params(route.dependant) if isinstance(it.field_info, Query)
    }
    if unknown := [name for name in request.query_params if name not in known]:
        raise RequestValidationError(
            [{"type": "extra_forbidden", "loc": ("query", name), "msg": ""} for name in unknown]
        )

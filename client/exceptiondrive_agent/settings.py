"""From the command line and the environment to the settings of a run."""

import json
from collections.abc import Mapping
from typing import Any

from exceptiondrive.inputs import given_protocol
from exceptiondrive_agent.errors import AgentError
from exceptiondrive_agent.report import Prices
from exceptiondrive_agent.run import RunSettings
from exceptiondrive_endpoints.endpoint import EndpointSettings, ModelSettings
from exceptiondrive_endpoints.settings import checked_address, checked_fields

_OUR_FIELDS = frozenset({"model", "messages", "response_format", "stream", "n"})


def run_settings(given: Mapping[str, Any], environment: Mapping[str, str]) -> RunSettings:
    """Return the settings that the options of `remind` or `decide` mean; the environment holds the key.

    Raises:
        InvalidArgumentError: An option makes no sense; the message names it.
    """
    return RunSettings(
        protocol=given_protocol(given["protocol"]),
        endpoint=EndpointSettings(
            base_url=checked_base_url(given["base_url"]),
            key=environment.get("EXCEPTIONDRIVE_AGENT_KEY") or environment.get("OPENAI_API_KEY"),
            timeout_s=given["timeout_s"],
            max_retries=given["max_retries"],
            requests_per_minute=given["requests_per_minute"],
            key_advice="Set EXCEPTIONDRIVE_AGENT_KEY or OPENAI_API_KEY.",
            address_advice="Correct --base-url or --model.",
        ),
        model=ModelSettings(
            model=given["model"],
            temperature=given["temperature"],
            max_tokens=given["max_tokens"],
            extra=extra_fields(given["extra_body"]),
        ),
        concurrency=given["concurrency"],
        views=tuple(view.strip() for view in (given["views"] or "").split(",") if view.strip()),
        limit=given["limit"],
        prices=prices(given["price_in"], given["price_out"]),
    )


def checked_base_url(text: str) -> str:
    """Return the address of the endpoint.

    Raises:
        AgentError: Not http(s), or it carries a password, which would end up in shell histories.
    """
    try:
        return checked_address(text)
    except ValueError as error:
        raise AgentError(
            f"--base-url: {error}.", "A key comes from EXCEPTIONDRIVE_AGENT_KEY."
        ) from None


def extra_fields(text: str | None) -> dict[str, Any]:
    """Parse --extra-body.

    Raises:
        AgentError: Not a JSON object, or it replaces a field that the agent itself must set.
    """
    if text is None:
        return {}
    try:
        extra = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise AgentError(f"--extra-body: not JSON: {error}") from None
    if not isinstance(extra, dict):
        raise AgentError("--extra-body: expected a JSON object")
    ours = sorted(_OUR_FIELDS & extra.keys())
    if ours:
        raise AgentError(f"--extra-body: the agent sets {', '.join(ours)} itself")
    try:
        return checked_fields(extra)
    except ValueError as error:
        raise AgentError(f"--extra-body: {error}") from None


def prices(price_in: float | None, price_out: float | None) -> Prices | None:
    """Prices per million tokens, or None when neither is given.

    Raises:
        AgentError: Only one is given: half a cost would mislead.
    """
    if price_in is None and price_out is None:
        return None
    if price_in is None or price_out is None:
        raise AgentError("give both --price-in and --price-out, or neither")
    return Prices(prompt=price_in, completion=price_out)

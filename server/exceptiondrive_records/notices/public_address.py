"""Whether an IP address is one of the public internet, and none of our own network."""

import ipaddress


def is_public(address: str) -> bool:
    """Whether a numeric address is public; one wrapped in IPv6 counts as what it wraps."""
    ip = ipaddress.ip_address(address)
    embedded = getattr(ip, "ipv4_mapped", None) or getattr(ip, "sixtofour", None)
    if embedded is not None:
        ip = embedded
    return ip.is_global and not ip.is_multicast


def is_known_private(host: str) -> bool:
    """Whether a host is private by its mere name: a numeric address, or this very machine."""
    try:
        return not is_public(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")

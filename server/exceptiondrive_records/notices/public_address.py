"""Whether an IP address is one of the public internet, and none of our own network."""

import ipaddress

_WRAPPING = tuple(map(ipaddress.ip_network, ("::/96", "::ffff:0:0:0/96", "64:ff9b::/96")))
"""The last 32 bits are an IPv4 address: compatible, translated (RFC 2765), NAT64 (RFC 6052)."""
_OF_OUR_OWN = tuple(map(ipaddress.ip_network, ("64:ff9b:1::/48", "fec0::/10")))
"""NAT64 within a network (RFC 8215) and site-local; the library calls both global."""


def is_public(address: str) -> bool:
    """Whether a numeric address is public; one wrapped in IPv6 counts as what it wraps."""
    ip = ipaddress.ip_address(address)
    if any(ip in network for network in _OF_OUR_OWN):
        return False
    embedded = getattr(ip, "ipv4_mapped", None) or getattr(ip, "sixtofour", None)
    if any(ip in network for network in _WRAPPING):
        embedded = ipaddress.IPv4Address(int(ip) & 0xFFFFFFFF)
    if embedded is not None:
        ip = embedded
    return ip.is_global and not ip.is_multicast


def is_known_private(host: str) -> bool:
    """Whether a host is private by its mere name: a numeric address, or this very machine."""
    try:
        return not is_public(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")

"""Whether an IP address is on the public internet rather than in our own network."""

import ipaddress

_WRAPPING = tuple(map(ipaddress.ip_network, ("::/96", "::ffff:0:0:0/96", "64:ff9b::/96")))
"""The last 32 bits are an IPv4 address: compatible, translated (RFC 2765), NAT64 (RFC 6052)."""
_NOT_PUBLIC = tuple(
    map(
        ipaddress.ip_network,
        (
            "64:ff9b:1::/48",
            "fec0::/10",
            "192.0.0.0/24",
            "192.88.99.0/24",
            "3fff::/20",
            "5f00::/16",
        ),
    )
)
"""NAT64 within a network (RFC 8215), site-local, protocol assignments (RFC 6890), the old 6to4 relays
(RFC 7526), documentation (RFC 9637), segment routing (RFC 9602); the library calls them global."""
_GLOBAL_UNICAST = ipaddress.ip_network("2000::/3")


def is_public(address: str) -> bool:
    """Whether a numeric address is public; one wrapped in IPv6 counts as what it wraps."""
    ip = ipaddress.ip_address(address)
    if any(ip in network for network in _NOT_PUBLIC):
        return False
    embedded = getattr(ip, "ipv4_mapped", None) or getattr(ip, "sixtofour", None)
    if any(ip in network for network in _WRAPPING):
        embedded = ipaddress.IPv4Address(int(ip) & 0xFFFFFFFF)
    if embedded is not None:
        ip = embedded
    if ip.version == 6 and ip not in _GLOBAL_UNICAST:
        return False
    if any(ip in network for network in _NOT_PUBLIC):
        return False
    return ip.is_global and not ip.is_multicast


def is_known_private(host: str) -> bool:
    """Whether a host is private by its name alone: a private numeric address, or this machine."""
    try:
        return not is_public(host)
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")

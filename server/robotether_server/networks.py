"""The network of an address, for limits that count addresses.

Used by joining.py and logging_in.py. One customer holds a whole /64 of IPv6, so its addresses count as one.
"""

from ipaddress import IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

Network = IPv4Network | IPv6Network

IPV6_PREFIX = 64
NOBODYS = ip_network("::")


def network_of(address: str) -> Network:
    """Return the network that counts as one; texts that are no address count as one too."""
    try:
        parsed = ip_address(address)
    except ValueError:
        return NOBODYS
    # An IPv4 address in IPv6 spelling: a /64 would throw all of them together.
    if isinstance(parsed, IPv6Address) and parsed.ipv4_mapped is None:
        return ip_network((parsed, IPV6_PREFIX), strict=False)
    return ip_network(parsed)

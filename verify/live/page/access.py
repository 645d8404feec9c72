"""Access to the page: this computer alone, or whoever holds the token; no other site's scripts.

A page of another origin in the same browser can send requests here, also under a name that it makes
point here (DNS rebinding). It cannot choose the headers Host and Origin: both are checked.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from verify.errors import InputError

COOKIE = "verify_token"
DEFAULT_PORT = 8646
LOOPBACK = "127.0.0.1"
OWN_NAMES = (LOOPBACK, "localhost", "[::1]")  # of this computer
MIN_TOKEN_LENGTH = 16  # characters: what nobody guesses over a network
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True, slots=True)
class PageAccess:
    """Where the page is served, and what a request must show."""

    address: str
    port: int
    token: str | None  # None: this computer alone

    @property
    def host(self) -> str:
        """The address as a browser names it."""
        return f"[{self.address}]" if ":" in self.address else self.address

    def refusal(
        self, headers: Mapping[str, str], cookie: str | None, *, script: bool
    ) -> str | None:
        """Say why a request is refused; None where it is not.

        Headers have their names in lower case; the cookie is the token that the browser keeps, or
        that the request gave otherwise. A script (a web socket) must be this page's own.
        """
        host, own = headers.get("host", ""), f"{self.host}:{self.port}"
        if self.token is None and host not in {own, *(f"{name}:{self.port}" for name in OWN_NAMES)}:
            return f"the page is not served under that name; open http://{own}/"
        origin = headers.get("origin")
        if (script or origin is not None) and origin != f"http://{host}":
            return "another site's page may not look at this one"
        if self.token is not None and not _equal_in_constant_time(cookie, self.token):
            return "the token is missing or wrong; open the address that `verify` printed"
        return None

    def matches(self, token: str | None) -> bool:
        """Whether this is the token."""
        return self.token is not None and _equal_in_constant_time(token, self.token)


def check_access(address: str, port: int, token: str | None) -> PageAccess:
    """Say who may look; every address but this computer's own needs a token.

    Raises:
        InputError: another address than loopback without a token, or one that is easily guessed.
    """
    if not is_loopback(address) and token is None:
        raise InputError(
            "--page", f"{address} can be reached by others", "they need a token",
            "Give one with --page-token, or leave the address at 127.0.0.1.",
        )  # fmt: skip
    if token is not None and len(token) < MIN_TOKEN_LENGTH:
        found = f"the token has {len(token)} characters"
        expected = f"at least {MIN_TOKEN_LENGTH}"
        raise InputError("--page-token", found, expected, "Take a longer one.")
    return PageAccess(address, port, token)


def is_loopback(address: str) -> bool:
    """Whether only this computer can reach an address."""
    if address == "localhost":
        return True
    import ipaddress

    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False


def _equal_in_constant_time(one: str | None, other: str) -> bool:
    import hmac  # not above: `--help` loads this module for its constants

    return one is not None and hmac.compare_digest(one.encode(), other.encode())

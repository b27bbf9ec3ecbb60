"""Who may look at the live page."""

import pytest

from deepseis_bringup.live.guard import Guard, token_from
from deepseis_core.errors import InputError

TOKEN = "correct horse battery staple"


@pytest.mark.parametrize("address", ["127.0.0.1", "127.8.0.1", "::1"])
def test_a_loopback_address_needs_no_token(address):
    assert Guard(address).admits("", "")


@pytest.mark.parametrize("address", ["0.0.0.0", "::", "192.168.1.5", "10.0.0.1"])
def test_any_other_address_needs_one(address):
    with pytest.raises(InputError, match="needs a token"):
        Guard(address)
    assert not Guard(address, TOKEN).admits("", "")


def test_a_name_of_its_own_needs_one_too():
    with pytest.raises(InputError, match=r"station\.example\.org: needs a token"):
        Guard("127.0.0.1", names=("station.example.org",))


@pytest.mark.parametrize("address", ["localhost", "", "1.2.3"])
def test_an_address_is_a_number(address):
    with pytest.raises(InputError, match="is no IP address"):
        Guard(address, TOKEN)


@pytest.mark.parametrize(
    ("authorization", "admitted"),
    [
        (f"Bearer {TOKEN}", True),
        (f"bearer {TOKEN}", True),
        (f"Bearer {TOKEN}x", False),
        (f"Basic {TOKEN}", False),
        ("Bearer ", False),
        ("", False),
        ("Bearer \udcff", False),
    ],
)
def test_the_token_admits_and_nothing_else_does(authorization, admitted):
    assert Guard("0.0.0.0", TOKEN).admits(authorization, "") is admitted


def test_the_cookie_admits_but_does_not_tell_the_token():
    guard, other = Guard("0.0.0.0", TOKEN), Guard("0.0.0.0", TOKEN + "2")
    assert guard.admits("", guard.cookie)
    assert not guard.admits("", other.cookie)
    assert not guard.admits("", TOKEN)
    assert TOKEN not in guard.cookie


@pytest.mark.parametrize(
    ("host", "known"),
    [
        ("127.0.0.1:8765", True),
        ("localhost:1", True),
        ("[::1]:80", True),
        ("LOCALHOST", True),
        ("192.168.0.7", True),
        ("seis.example.org", True),
        ("Seis.Example.org:443", True),
        ("evil.example", False),
        ("localhost.evil.example", False),
        ("", False),
        (None, False),
        ("127.0.0.1.evil.example", False),
        ("[::1", False),
        ("seis.example.org.", False),
    ],
)
def test_hosts_are_addresses_or_names_that_were_given(host, known):
    assert Guard("127.0.0.1", TOKEN, ("seis.example.org",)).knows_host(host) is known


@pytest.mark.parametrize(
    ("origin", "host", "known"),
    [
        ("http://127.0.0.1:80", "127.0.0.1:80", True),
        ("https://a.example", "a.example", True),
        (None, "127.0.0.1", True),
        ("http://evil.example", "127.0.0.1", False),
        ("http://127.0.0.1:81", "127.0.0.1:80", False),
        ("null", "127.0.0.1", False),
    ],
)
def test_live_connections_come_from_the_page_itself(origin, host, known):
    assert Guard("127.0.0.1").knows_origin(origin, host) is known


def test_tokens_come_from_a_file_or_the_environment(tmp_path):
    path = tmp_path / "token"
    path.write_text(f"{TOKEN}\n")
    environment = {"DEEPSEIS_WEB_TOKEN": "one from the environment"}
    assert token_from(str(path), environment) == TOKEN
    assert token_from("", environment) == "one from the environment"
    assert token_from("", {}) == ""


@pytest.mark.parametrize("text", ["", "short"])
def test_short_tokens_are_refused(tmp_path, text):
    path = tmp_path / "token"
    path.write_text(text)
    with pytest.raises(InputError, match="fewer than 16"):
        token_from(str(path), {})
    with pytest.raises(InputError, match="No such file"):
        token_from(str(tmp_path / "none"), {})

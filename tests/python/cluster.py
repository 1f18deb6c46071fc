"""A local Ray cluster that loses a node."""

from collections import Counter
from contextlib import contextmanager

import pytest

from common import wait
from crazyflie_gym.sweep import Store


@contextmanager
def losing_a_node(path, after):
    """Give the address of a cluster of three nodes, and a store that kills one when so many results have come."""
    ray = pytest.importorskip("ray", reason="Ray is not installed (extra ray): clusters are not tested")
    from ray.cluster_utils import Cluster

    def alive():
        return sum(node["Alive"] for node in ray.nodes())

    # a node that is gone refuses connections at once, which need not be tried for a quarter of a minute
    health = {"health_check_initial_delay_ms": 500, "health_check_period_ms": 500}
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "_system_config": health})
    try:
        doomed = cluster.add_node(num_cpus=1)
        cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address, log_to_driver=False)
        assert alive() == 3

        class Watched(Store):
            """Counts what comes, by its key."""

            came: Counter[str] = Counter()

            def add(self, key, flights):
                self.came[key] += 1
                if self.came.total() == after:
                    cluster.remove_node(doomed, allow_graceful=False)
                    wait(lambda: alive() == 2, pause_s=0.1)
                return super().add(key, flights)

        with Watched(path) as store:
            yield cluster.address, store
        assert alive() == 2
    finally:
        ray.shutdown()
        cluster.shutdown()

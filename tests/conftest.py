"""Shared by all tests: checked annotations, small worlds, and a plain Python world to compare against."""

import importlib
import os
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jaxtyping
import numpy as np
import pytest
from hypothesis import settings

from cellpilot.airspace import MOVE_SETS, Airspace, Rule
from cellpilot.grid import Grid
from cellpilot.signal import Signal, Unknown
from cellpilot.world import World

# Workers of `-n auto` and commands inherit this: threads of several processes on the same cores wait for each other, and a
# Gaussian process takes forty times as long.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

jaxtyping.install_import_hook(["cellpilot.envs.arena", "cellpilot.envs.flight", "cellpilot.learn"], "beartype.beartype")

WITHOUT_JAX = {"core", "maps", "radio"}
"""Folders of tests that do without compiled code, and are not to wait for its import."""


@cache
def check_annotations() -> None:
    """Import all compiled code, with checked annotations of its functions."""
    import equinox as eqx

    for name in ("trainer", "algorithms.ddqn_her", "algorithms.ddqn_her_variants", "algorithms.fqi_her_online", "in_turn"):
        importlib.import_module(f"cellpilot.learn.{name}")
    for module in [module for name, module in sys.modules.items() if name.startswith(("cellpilot.envs.", "cellpilot.learn."))]:
        for found in vars(module).values():
            # JAX rebuilds its dataclasses with whatever a tree function returns; only functions are checked.
            own = isinstance(found, type) and found.__module__ == module.__name__
            if own and is_dataclass(found) and not issubclass(found, eqx.Module):
                found.__init__ = getattr(found.__init__, "__wrapped__", found.__init__)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Annotations are checked in all tests that can meet compiled code."""
    if item.path.parent.name not in WITHOUT_JAX:
        check_annotations()


settings.register_profile("cellpilot", deadline=None, max_examples=40)
settings.load_profile("cellpilot")


UKM = Path(__file__).parents[2] / "shared" / "data" / "ukm"
"""The measured logs that lie beside the checkout; tests marked `shared` need them."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--slow` also runs what takes more than twenty seconds, `--raytrace` what needs Sionna RT and LLVM."""
    parser.addoption("--slow", action="store_true", help="also run tests marked slow")
    parser.addoption("--raytrace", action="store_true", help="also run tests marked raytrace")


def pytest_configure(config: pytest.Config) -> None:
    """The markers, so that `--strict-markers` knows them, and one cache of compiled programs for all workers and commands."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        cache_folder = tempfile.TemporaryDirectory(prefix="compiled-")
        config.add_cleanup(cache_folder.cleanup)
        os.environ["JAX_COMPILATION_CACHE_DIR"] = cache_folder.name
        os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.1"
    config.addinivalue_line("markers", "slow: takes more than twenty seconds; runs with --slow")
    config.addinivalue_line("markers", "raytrace: traces rays with Sionna RT; runs with --raytrace")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the slow ones out unless they are asked for, and those on measured logs where there are none."""
    left_out = {name: f"{name}: run with --{name}" for name in ("slow", "raytrace") if not config.getoption(f"--{name}")}
    if not UKM.is_dir():
        left_out["shared"] = "the measured logs (../shared/data/ukm) are not beside the checkout"
    for item in items:
        for name, reason in left_out.items():
            if item.get_closest_marker(name):
                item.add_marker(pytest.mark.skip(reason=reason))


Triple = tuple[int, int, int]
DIRECTIONS = {"north": (0, 1, 0), "south": (0, -1, 0), "east": (1, 0, 0), "west": (-1, 0, 0), "up": (0, 0, 1), "down": (0, 0, -1)}


@dataclass(frozen=True)
class PlainWorld:
    """An independent world of tuples, sets and dictionaries; knows nothing of `Grid` and `World`."""

    sides: Triple
    blocked: frozenset[Triple]

    @property
    def moves(self) -> list[Triple]:
        """Moves in the order of the actions; without up and down where there is one height."""
        names = ["north", "south", "east", "west"] + (["up", "down"] if self.sides[2] > 1 else [])
        return [DIRECTIONS[name] for name in names]

    @property
    def positions(self) -> list[Triple]:
        """All positions in the order of cell numbers: x runs fastest, then y, then z."""
        nx, ny, nz = self.sides
        return [(x, y, z) for z in range(nz) for y in range(ny) for x in range(nx)]

    def cell(self, position: Triple) -> int:
        """Number of a position, by counting."""
        return self.positions.index(position)

    def step(self, position: Triple, action: int) -> tuple[Triple, bool]:
        """Position after the action, and whether a blocked one stopped it."""
        x, y, z = (a + b for a, b in zip(position, self.moves[action], strict=True))
        if not (0 <= x < self.sides[0] and 0 <= y < self.sides[1] and 0 <= z < self.sides[2]):
            return position, False
        return (position, True) if (x, y, z) in self.blocked else ((x, y, z), False)

    def distances(self, source: Triple) -> dict[Triple, int]:
        """Moves from every position that can be reached, breadth first."""
        found, queue = {source: 0}, deque([source])
        while queue:
            here = queue.popleft()
            for action in range(len(self.moves)):
                there, _ = self.step(here, action)
                if there not in found:
                    found[there] = found[here] + 1
                    queue.append(there)
        return found

    def parts(self) -> list[set[Triple]]:
        """Connected parts of the free positions, by flood fill."""
        left = {p for p in self.positions if p not in self.blocked}
        parts = []
        while left:
            part = set(self.distances(next(iter(left))))
            parts.append(part)
            left -= part
        return parts


MakeWorld = Callable[..., World]


@pytest.fixture(scope="session")
def make_world() -> MakeWorld:
    """A world from its sides; SINR (default 10 dB everywhere), blocked positions and spreads as asked for."""

    def make(
        sides: Triple,
        sinr_db: object = 10.0,
        blocked: Iterable[Triple] = (),
        noise_std_db: float = 0.0,
        sinr_std_db: object = 0.0,
        rule: Rule = "stay",
        n_moves: int | None = None,
        correlation_m: float = 0.0,
        common_std_db: float = 0.0,
    ) -> World:
        grid = Grid(*(tuple(20.0 * i + 10.0 for i in range(n)) for n in sides))
        n = grid.n_cells
        mask = np.zeros(sides[::-1], bool)
        for x, y, z in blocked:
            mask[z, y, x] = True
        sinr = np.broadcast_to(np.asarray(sinr_db, np.float32), n).copy()
        std = np.broadcast_to(np.asarray(sinr_std_db, np.float32), n).copy()
        airspace = Airspace.of_blocked(grid, mask.ravel(), rule, None if n_moves is None else MOVE_SETS[n_moves])
        return World(airspace, Signal(sinr, noise_std_db, Unknown.of(grid, std, correlation_m, common_std_db)))

    return make


@pytest.fixture(scope="session")
def random_world(make_world: MakeWorld) -> MakeWorld:
    """A world with random SINR around the threshold and random blocked cells; the first two cells stay free."""

    def make(
        seed: int,
        sides: Triple,
        blocked_share: float = 0.0,
        noise_std_db: float = 0.0,
        sinr_std_db: float = 0.0,
        n_free_first: int = 2,
        **more: Any,
    ) -> World:
        rng = np.random.default_rng(seed)
        n = sides[0] * sides[1] * sides[2]
        chosen = rng.random(n) < blocked_share
        chosen[:n_free_first] = False
        positions = PlainWorld(sides, frozenset()).positions
        blocked = [p for p, b in zip(positions, chosen, strict=True) if b]
        return make_world(sides, rng.normal(3.0, 6.0, n), blocked, noise_std_db, sinr_std_db * rng.random(n), **more)

    return make


@pytest.fixture(scope="session")
def plain() -> Callable[[World], PlainWorld]:
    """The plain Python world of a `World`."""

    def make(world: World) -> PlainWorld:
        empty = PlainWorld(world.grid.sides, frozenset())
        return PlainWorld(
            world.grid.sides, frozenset(p for p, b in zip(empty.positions, world.airspace.blocked.tolist(), strict=True) if b)
        )

    return make

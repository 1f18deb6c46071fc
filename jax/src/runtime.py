class Box(NamedTuple):
    """Bounds, shape and type of an array."""

    low: np.ndarray
    high: np.ndarray
    shape: tuple
    dtype: np.dtype


def default_params():
    """Parameters as the options said; the middle of those that were to be drawn."""
    return Params()


def sample_params(key, shape=()):
    """Parameters drawn from the distributions that the options gave; `shape` for several environments at once."""
    params = jax.tree.map(lambda number: jnp.full(shape, number), Params())
    for place, (group, name, kind, numbers, low, high) in enumerate(DISTRIBUTIONS):
        one = jax.random.fold_in(key, place)
        if kind == "uniform":
            value = jax.random.uniform(one, shape, minval=numbers[0], maxval=numbers[1])
        elif kind == "log_uniform":
            value = jnp.exp(jax.random.uniform(one, shape, minval=np.log(numbers[0]), maxval=np.log(numbers[1])))
        elif kind == "normal":
            value = numbers[0] + numbers[1] * jax.random.normal(one, shape)
        else:
            value = jax.random.choice(one, jnp.asarray(numbers, float), shape)
        new = getattr(params, group)._replace(**{name: jnp.clip(value, low, high)})
        params = params._replace(**{group: new})
    return params


def _key_words(key):
    key = jnp.asarray(key)
    if jax.dtypes.issubdtype(key.dtype, jax.dtypes.prng_key):
        key = jax.random.key_data(key)
    if key.dtype != jnp.uint32 or key.shape[-1:] != (2,):
        raise TypeError(f"key: expected jax.random.key(seed), got {key.dtype} of shape {key.shape}")
    return key[..., 0], key[..., 1]


class Environment:
    """The environment as pure functions.

    Arrays may have leading axes, the same for all of them: none under `jax.vmap`, or `num_envs` after
    `reset(key, num_envs=...)`, which is the faster way. Lengths are in metres, angles in radians, times in seconds.

    `reward(state, action, params)` and `observation(state, params)` take the place of the task's own; `state` is that
    at the end of the step. An action that is no number ends its flight at once.
    """

    id = ID
    num_drones = DRONES
    num_actions = 4
    tick_s = TICK_S
    max_episode_steps = MAX_EPISODE_STEPS
    fields = FIELDS

    def __init__(self, *, reward=None, observation=None, dtype=jnp.float32):
        self.dtype = jnp.dtype(dtype)
        if self.dtype not in (jnp.float32, jnp.float64):
            raise ValueError(f"dtype: expected float32 or float64, got {self.dtype}")
        if jnp.zeros((), self.dtype).dtype != self.dtype:
            raise ValueError('dtype: float64 needs jax.config.update("jax_enable_x64", True) first')
        self._own_reward, self._own_observation = reward, observation

    @property
    def default_params(self):
        """See `default_params`."""
        return Params()

    def sample_params(self, key, shape=()):
        """See `sample_params`."""
        return sample_params(key, shape)

    def observation_space(self, params=None):
        """Bounds of a drone's observation."""
        low, high = (np.concatenate([np.full(f[1], f[i]) for f in FIELDS]).astype(self.dtype) for i in (3, 4))
        return Box(low, high, low.shape, np.dtype(self.dtype))

    def action_space(self, params=None):
        """Bounds of a drone's action."""
        one = np.ones(4, self.dtype)
        return Box(-one, one, one.shape, np.dtype(self.dtype))

    def reset(self, key, params=None, num_envs=None):
        """Begins an episode, or `num_envs` of them: observations and state."""
        low, high = _key_words(key)
        if num_envs is not None:
            low = low ^ (jnp.arange(num_envs, dtype=jnp.uint32) * np.uint32(0x9E3779B9))
            high = jnp.broadcast_to(high, low.shape)
        words = [word for drone in range(DRONES) for word in (low + np.uint32(7919 * drone), high)]
        params = self._params(params)
        state, rows = _begin_next([*words, jnp.zeros_like(low)], params, self._starts(), self.dtype)
        return self._seen(rows, state, params), state

    def begin(self, keys, start, params=None):
        """Begins episodes with these words, `uint32` of shape (..., drones, 2), and numbers of the start.

        Numbers that all starts have in common are part of the program.
        """
        keys, start, params = jnp.asarray(keys, jnp.uint32), jnp.asarray(start, self.dtype), self._params(params)
        words = [keys[..., drone, i] for drone in range(DRONES) for i in range(2)]
        for i, number in enumerate(START):
            own = None if number is None or isinstance(start, jax.core.Tracer) else np.asarray(start[..., i])
            if own is not None and not np.allclose(own, number):
                raise ValueError(f"start: number {i} is {number} in all starts of this environment, got {own}")
        state, rows = _begin(words, [start[..., i] for i in range(len(START))], params, self.dtype)
        return self._seen(rows, state, params), state

    def step_env(self, key, state, action, params=None):
        """A tick without resets: observations, state, rewards, done, and what is known besides."""
        params = self._params(params)
        rows, new, reward, done, info = self._advance(state, action, params)
        return self._seen(rows, new, params), new, reward, done, info

    def step(self, key, state, action, params=None):
        """As `step_env`; episodes that are done begin anew, drawn by `key` and the last episode's own noise.

        One key for all environments and steps will do: episodes differ anyway.
        """
        params = self._params(params)
        rows, new, reward, done, info = self._advance(state, action, params)

        def begin_anew():
            return _begin_where(done, _key_words(key), new, rows, params, self._starts(), self.dtype)

        def go_on():
            # chosen too, so that in a shard constants vary as the others do
            return _where(done, (new, rows), (new, rows))

        def begin_if_any():
            return jax.lax.cond(jnp.any(done), begin_anew, go_on)

        # a GPU begins episodes in the kernel of the tick, and a condition would part the two; a processor rather
        # leaves out what it can
        new, rows = _dependent(lambda: jax.lax.optimization_barrier(begin_anew()), begin_if_any)()
        return self._seen(rows, new, params), new, reward, done, info

    def fly(self, key, observation, state, actions, ticks=None, params=None, weights=(), fused=None):
        """Flies many ticks as `step` does: observations, state, sums of rewards, numbers of episodes that ended.

        On a GPU the state stays in the registers of one kernel, without gradients. Elsewhere, in double precision and
        with the user's own reward or observation, it is carried by `lax.scan`. `fused` forces one or the other; the
        kernel is interpreted where there is no GPU.

        `actions` is a table of shape (ticks, ..., 4), or a function `actions(weights, columns)`, which returns the four
        numbers of a drone's action for those of its observation. In a kernel there are columns and numbers alone:
        the function takes `weights`, a tree of arrays, apart by index, as in `weights[i, j] * columns[i]`.
        """
        ask = actions if callable(actions) else None
        given = weights if ask else jnp.asarray(actions, self.dtype)
        ticks = len(given) if ticks is None else ticks
        own = self._own_reward is not None or self._own_observation is not None or self.dtype != jnp.float32
        if fused and own:
            raise ValueError("fused: a kernel has the task's own reward and observation, in float32")
        gpu = jax.default_backend() == "gpu"
        flown = (observation, state, given, self._params(params), *_key_words(key))
        scan = functools.partial(self._fly_scan, ask, ticks)
        kernel = functools.partial(_fly_kernel, ask, ticks, interpret=not gpu)
        if fused or fused is False or own or not gpu:
            return (kernel if fused else scan)(*flown)
        return _dependent(kernel, scan)(*flown)

    def _fly_scan(self, ask, ticks, observation, state, given, params, low, high):
        key = jnp.stack([low, high], -1)

        def tick(carry, action):
            observation, state, paid, ended = carry
            if ask:
                action = _side_by_side([jnp.stack(ask(given, row), -1) for row in _columns(observation)], -2)
            observation, state, reward, done, _ = self.step(key, state, action, params)
            return (observation, state, paid + reward, ended + done), None

        zero = jnp.zeros(state.noise[-1].shape, self.dtype)
        carry = (observation, state, _side_by_side([zero] * DRONES), zero.astype(jnp.int32))
        return jax.lax.scan(tick, carry, None if ask else given, length=ticks)[0]

    def true_state(self, state):
        """Position, velocity, attitude and rates as arrays of shape (..., 3), or (..., drones, 3)."""
        return {name: _side_by_side([jnp.stack(part, -1) for part in _drones(state, name)], -2) for name in TRUE}

    def _advance(self, state, action, params):
        action = self._checked(action, state)
        new, rows, rewards, ends, late, done = _tick_checked(state, _columns(action), params, self.dtype)
        reward = _side_by_side(rewards)
        if self._own_reward is not None:
            reward = self._own_reward(new, jnp.clip(action, -1.0, 1.0), params)
        return rows, new, reward, done, {"terminated": _side_by_side(ends), "truncated": _side_by_side(late)}

    def _seen(self, rows, state, params):
        """The observation: the user's own, or the columns of `rows` side by side."""
        if self._own_observation is not None:
            return self._own_observation(state, params)
        return _side_by_side([jnp.stack(row, -1) for row in rows], -2)

    def _starts(self):
        return jnp.asarray(STARTS, self.dtype)

    def _params(self, params):
        params = Params() if params is None else params
        if not isinstance(params, Params):
            raise TypeError(f"params: expected {Params.__name__}, see default_params, got {type(params).__name__}")
        return jax.tree.map(lambda number: jnp.asarray(number, self.dtype), params)

    def _checked(self, action, state):
        action = jnp.asarray(action)
        shape = state.noise[-1].shape + ((DRONES,) if DRONES > 1 else ()) + (4,)
        if action.shape != shape:
            raise ValueError(f"action: expected shape {shape} for this state, got {action.shape}")
        if not jnp.issubdtype(action.dtype, jnp.floating):
            raise TypeError(f"action: expected {self.dtype} from -1 to 1, got {action.dtype}")
        return action.astype(self.dtype)


def _tick_checked(state, action, params, real):
    """A tick, and whether the episode is over. An action that is no number counts as zero and ends it."""
    wrong = [(a != a) | (b != b) | (c != c) | (d != d) for a, b, c, d in action]
    action = [[jnp.where(a == a, jnp.clip(a, -1.0, 1.0), 0.0) for a in row] for row in action]
    new, rows, rewards, ends, late = _tick(state, action, params, real)
    ends = [end | bad for end, bad in zip(ends, wrong, strict=True)]
    if DRONES == 1:
        return new, rows, rewards, ends, late, ends[0] | late[0]
    flies = sum(new.flies)
    return new, rows, rewards, ends, late, functools.reduce(operator.or_, wrong, flies <= 0)


def _begin_next(noise, params, starts, real):
    """The episodes that follow on those of this noise: state and observations."""
    *words, tick = noise
    forked = [_fork(low, high, tick) for low, high in zip(words[::2], words[1::2], strict=True)]
    pick = forked[0][2] % np.uint32(STARTS.shape[1])
    drawn = iter(range(len(STARTS)))
    numbers = [starts[next(drawn), pick] if number is None else number for number in START]
    return _begin([word for low, high, _ in forked for word in (low, high)], numbers, params, real)


def _begin_where(done, key, state, rows, params, starts, real):
    """State and observations, where `done` those of the next episode."""
    words = [word ^ key[i % 2] for i, word in enumerate(state.noise[:-1])]
    begun = _begin_next([*words, state.noise[-1]], params, starts, real)
    return _where(done, begun, (state, rows))


def _where(done, yes, no):
    return jax.tree.map(lambda a, b: jnp.where(done, a, b), yes, no)


def _dependent(gpu, other):
    """One function on a GPU, another elsewhere."""
    return functools.partial(jax.lax.platform_dependent, cuda=gpu, default=other)


def _columns(rows):
    """Each drone's numbers, of an array that has a row for each."""
    drones = [rows] if DRONES == 1 else [rows[..., drone, :] for drone in range(DRONES)]
    return tuple(tuple(row[..., i] for i in range(row.shape[-1])) for row in drones)


def _side_by_side(drones, axis=-1):
    """One drone's array, or those of several along an axis of their own."""
    return drones[0] if DRONES == 1 else jnp.stack(drones, axis)


def _drones(state, name):
    if DRONES == 1:
        return [getattr(state, name)]
    return [getattr(state, f"drone{drone}_{name}") for drone in range(DRONES)]

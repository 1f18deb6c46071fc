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
    at the end of the step.
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
        words = tuple((low + np.uint32(7919 * drone), high) for drone in range(DRONES))
        return self._begin_drawn(words, jnp.zeros_like(low), self._params(params))

    def begin(self, keys, start, params=None):
        """Begins episodes with these words, `uint32` of shape (..., drones, 2), and numbers of the start."""
        keys = jnp.asarray(keys, jnp.uint32)
        start = jnp.asarray(start, self.dtype)
        words = [(keys[..., drone, 0], keys[..., drone, 1]) for drone in range(DRONES)]
        numbers = [start[..., i] for i in range(len(START))]
        return self._shown(*_begin(words, numbers, self._params(params), self.dtype), params)

    def step_env(self, key, state, action, params=None):
        """A tick without resets: observations, state, rewards, done, and what is known besides."""
        action = self._checked(action, state)
        params = self._params(params)
        new, observations, rewards, ends, late = _tick(state, action, params, self.dtype)
        observations, new = self._shown(new, observations, params)
        terminated, truncated = _side_by_side(ends), _side_by_side(late)
        reward = _side_by_side(rewards)
        if self._own_reward is not None:
            reward = self._own_reward(new, action, params)
        info = {"terminated": terminated, "truncated": truncated}
        return observations, new, reward, _over(new, terminated, truncated), info

    def step(self, key, state, action, params=None):
        """As `step_env`; episodes that are done begin anew, drawn by `key` and the last episode's own noise.

        One key for all environments and steps will do: episodes differ anyway.
        """
        observations, new, reward, done, info = self.step_env(key, state, action, params)

        def begin_anew():
            low, high = _key_words(key)
            words = tuple((lo ^ low, hi ^ high) for lo, hi, _ in _words(new))
            fresh = self._begin_drawn(words, new.noise[2], self._params(params))
            return jax.tree.map(lambda a, b: _choose(done, a, b), fresh, (observations, new))

        observations, new = jax.lax.cond(jnp.any(done), begin_anew, lambda: (observations, new))
        return observations, new, reward, done, info

    def true_state(self, state):
        """Position, velocity, attitude and rates as arrays of shape (..., 3), or (..., drones, 3)."""
        return {name: _side_by_side([jnp.stack(part, -1) for part in _drones(state, name)], -2) for name in TRUE}

    def _begin_drawn(self, words, tick, params):
        forked = [_fork(low, high, tick) for low, high in words]
        pick = forked[0][2] % np.uint32(len(STARTS))
        drawn = iter(jnp.moveaxis(jnp.asarray(STARTS, self.dtype)[pick], -1, 0))
        numbers = [next(drawn) if number is None else jnp.full(pick.shape, number, self.dtype) for number in START]
        begun = _begin([(low, high) for low, high, _ in forked], numbers, params, self.dtype)
        return self._shown(*begun, params)

    def _shown(self, state, observations, params):
        if self._own_observation is not None:
            return self._own_observation(state, params), state
        rows = [jnp.stack(jnp.broadcast_arrays(*row), -1) for row in observations]
        return _side_by_side(rows, -2), state

    def _params(self, params):
        params = Params() if params is None else params
        if not isinstance(params, Params):
            raise TypeError(f"params: expected {Params.__name__}, see default_params, got {type(params).__name__}")
        return jax.tree.map(lambda number: jnp.asarray(number, self.dtype), params)

    def _checked(self, action, state):
        action = jnp.asarray(action)
        shape = state.noise[0].shape + ((DRONES,) if DRONES > 1 else ()) + (4,)
        if action.shape != shape:
            raise ValueError(f"action: expected shape {shape} for this state, got {action.shape}")
        if not jnp.issubdtype(action.dtype, jnp.floating):
            raise TypeError(f"action: expected {self.dtype} from -1 to 1, got {action.dtype}")
        return jnp.clip(action.astype(self.dtype), -1.0, 1.0)


def _side_by_side(drones, axis=-1):
    """One drone's array, or those of several along an axis of their own."""
    return drones[0] if DRONES == 1 else jnp.stack(jnp.broadcast_arrays(*drones), axis)


def _words(state):
    return [state.noise[3 * drone : 3 * drone + 3] for drone in range(DRONES)]


def _drones(state, name):
    if DRONES == 1:
        return [getattr(state, name)]
    return [getattr(state, f"drone{drone}_{name}") for drone in range(DRONES)]


def _over(state, terminated, truncated):
    if DRONES == 1:
        return terminated | truncated
    return jnp.all(jnp.stack(state.flies, -1) <= 0, -1)


def _choose(done, yes, no):
    return jnp.where(done.reshape(done.shape + (1,) * (yes.ndim - done.ndim)), yes, no)

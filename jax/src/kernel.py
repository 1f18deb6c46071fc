

# environments of a program of the kernel, one for each of its threads
_BLOCK = 128


def _like(array):
    return jax.ShapeDtypeStruct(array.shape, array.dtype)


def _pad(count, numbers, *axes, before=0):
    """One axis of whole blocks in the place of the leading ones, whose product is `count`, and `axes` after it."""
    flat = numbers.reshape(*numbers.shape[:before], count, *axes)
    return jnp.pad(flat, [(0, -count % _BLOCK if i == before else 0) for i in range(flat.ndim)])


def _fly_kernel(ask, ticks, observation, state, given, params, *key, interpret=False):
    """As `Environment.fly`: a program of the kernel keeps its environments in registers for all ticks."""
    from jax.experimental import pallas
    from jax.experimental.pallas import triton

    lead, shape = state.noise[-1].shape, observation.shape
    count = int(np.prod(lead))
    padded, rest = functools.partial(_pad, count), -count % _BLOCK
    zero = jnp.zeros(lead, jnp.float32)
    columns = jax.tree.map(padded, (state, (zero,) * DRONES, zero.astype(jnp.int32)))
    params = jax.tree.map(lambda number: padded(jnp.broadcast_to(number, lead)), params)
    observation = padded(observation, DRONES, shape[-1])
    given = jax.tree.map(jnp.asarray, given) if ask else padded(given, DRONES, 4, before=1)
    # a table without rows is no operand
    starts = np.resize(STARTS, (max(len(STARTS), 1), STARTS.shape[1]))
    shared = (observation, given, jnp.stack(key), jnp.asarray(starts, jnp.float32))

    def kernel(columns, params, shared, seen, *flown):
        here = pallas.ds(pallas.program_id(0) * _BLOCK, _BLOCK)
        observation, given, key, starts = shared
        rows = tuple(tuple(observation[here, j, i] for i in range(shape[-1])) for j in range(DRONES))
        columns, params = jax.tree.map(lambda ref: ref[...], (columns, params))

        def tick(i, carried):
            rows, (state, paid, ended) = carried
            action = [ask(given, row) for row in rows] if ask else given_action(i)
            state, rows, rewards, _, _, done = _tick_checked(state, action, params, jnp.float32)
            state, rows = _begin_where(done, key, state, rows, params, starts, jnp.float32)
            return rows, (state, tuple(a + b for a, b in zip(paid, rewards, strict=True)), ended + done)

        def given_action(i):
            return [[given[i, here, drone, j] for j in range(4)] for drone in range(DRONES)]

        _KERNELS.append(kernel)
        try:
            rows, columns = jax.lax.fori_loop(0, ticks, tick, (rows, columns))
        finally:
            _KERNELS.pop()
        for j, row in enumerate(rows):
            for i, column in enumerate(row):
                seen[here, j, i] = column
        jax.tree.map(lambda ref, column: ref.__setitem__(..., column), flown, columns)

    block, whole = pallas.BlockSpec((_BLOCK,), lambda i: (i,)), pallas.BlockSpec()
    blocks = jax.tree.map(lambda _: block, columns)
    seen, *flown = pallas.pallas_call(
        kernel,
        jax.tree.map(_like, (observation, *columns)),
        grid=((count + rest) // _BLOCK,),
        in_specs=[blocks, jax.tree.map(lambda _: block, params), jax.tree.map(lambda _: whole, shared)],
        out_specs=(whole, *blocks),
        compiler_params=None if interpret else triton.CompilerParams(num_warps=_BLOCK // 32),
        interpret=interpret,
    )(columns, params, shared)
    state, paid, ended = jax.tree.map(lambda leaf: leaf[:count].reshape(lead), flown)
    return seen[:count].reshape(shape), state, _side_by_side(paid), ended

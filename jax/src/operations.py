def _smaller(a, b):
    return jnp.where(b < a, b, a)


def _larger(a, b):
    return jnp.where(a < b, b, a)


@jax.custom_jvp
def _sqrt(x):
    """The square root, whose derivative at zero is taken as zero."""
    return jnp.sqrt(x)


@_sqrt.defjvp
def _sqrt_jvp(primals, tangents):
    root = jnp.sqrt(primals[0])
    positive = root > 0
    return root, jnp.where(positive, 0.5 / jnp.where(positive, root, 1.0), 0.0) * tangents[0]


# within a kernel, see `_round`
_KERNELS = []


def _round(x):
    """To the nearest integer, the even one of two; a kernel has floors alone."""
    if not _KERNELS:
        return jnp.round(x)
    near = jnp.floor(x + 0.5)
    over, odd = near - x, near != 2.0 * jnp.floor(0.5 * near)
    return near - jnp.where((over > 0.5) | ((over == 0.5) & odd), 1.0, 0.0)


def _unit(word, real):
    """A word as a number strictly between 0 and 1."""
    return ((word >> np.uint32(9)).astype(real) + 0.5) * (1.0 / 8388608.0)


def _exponent(x):
    """The power of two that leaves a mantissa in [sqrt(1/2), sqrt(2))."""
    if x.dtype == jnp.float64:
        bits = jax.lax.bitcast_convert_type(x, jnp.int64) - 0x3FE6A09E667F3BCD
        return jax.lax.stop_gradient((bits >> 52).astype(x.dtype))
    bits = jax.lax.bitcast_convert_type(x, jnp.int32) - 0x3F3504F3
    return jax.lax.stop_gradient((bits >> 23).astype(x.dtype))


def _power_of_two(exponent):
    if exponent.dtype == jnp.float64:
        return jax.lax.bitcast_convert_type((exponent.astype(jnp.int64) + 1023) << 52, jnp.float64)
    return jax.lax.bitcast_convert_type((exponent.astype(jnp.int32) + 127) << 23, jnp.float32)


def _mantissa(x):
    return x * _power_of_two(-_exponent(x))


def _scale_exponent(x, exponent):
    return x * jax.lax.stop_gradient(_power_of_two(exponent))

"""The only place that imports the compiled module touchnet._C."""

try:
    from touchnet import _C
except ImportError as error:
    raise ImportError(
        f"touchnet's compiled extension did not load ({error}). Build it with `pip install .` in the source tree "
        "(`pip install -e .` while developing), or `pip install --force-reinstall --no-binary touchnet touchnet`. "
        "TOUCHNET_BACKEND=reference selects the slow pure-Python operators instead."
    ) from error

__all__ = ["_C"]

"""For all tests."""

from hypothesis import settings

# How long something takes is for benchmarks to say: machines are slow at times, and a first call compiles or imports.
settings.register_profile("miniloop", deadline=None)
settings.load_profile("miniloop")

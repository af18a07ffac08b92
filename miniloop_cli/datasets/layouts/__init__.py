"""The built-in layouts of recordings, one file each; `registry.BUILT_IN` lists them."""

"""The layouts that recordings come in, one file each; `registry.BUILT_IN` lists them."""

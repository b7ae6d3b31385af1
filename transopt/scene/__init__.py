"""Scene files: TOML files that state everything a library is designed from.

`sections` defines the tables of a scene file, `scene` the scene as a whole and its models. `file` reads it, `keys`
lists its keys for studies that vary them. `strikes` simulates the recordings of scenes without recorded files.
A scene may name a model file in place of its own model: `model_parts` defines the content of such a file, `fitted`
the uncertainty of its numbers; `model_file` reads and writes it, and `identified` is the scene's model made of it.
"""

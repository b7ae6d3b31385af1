"""Scene files: everything that defines one library, stated in a TOML file.

`sections` has the tables of a scene file, `scene` the scene as a whole and the models it makes, `file` reads it, and
`keys` lists its keys for studies that vary them. `strikes` simulates the recordings of scenes that have no files.
A scene may name a model file in place of a model of its own: `model_parts` says what such a file holds, `fitted` what
a fit knows about its numbers, `model_file` reads and writes it, and `identified` is a scene's model made of it.
"""

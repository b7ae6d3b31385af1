"""`transopt scene`: the built-in scenes, a copy of one to change, and every key that a scene may state."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from transopt.base import terminal
from transopt.base.errors import InputError

if TYPE_CHECKING:
    from transopt.base.tables import Table
    from transopt.scene.scene import Scene

DEFAULT_SCENE = "wood_on_foam"

app = typer.Typer(
    no_args_is_help=True,
    help="Built-in scenes: list, show, copy; the keys of a scene.",
    epilog="Example: transopt scene list",
)


@app.command("list", epilog="Example: transopt scene list")
def scene_list() -> None:
    """Name the built-in scenes and what each shows."""
    import tomllib

    from rich.table import Table

    from transopt.scene import builtin

    listed = Table.grid("name", "what it shows", padding=(0, 2))
    listed.columns[0].no_wrap = True
    for name in builtin.scene_names():
        text = builtin.scene_path(name).read_text(encoding="utf-8")
        listed.add_row(name, tomllib.loads(text)["description"])
    terminal.console().print(listed)


@app.command("show", epilog="Example: transopt scene show wood_on_foam")
def scene_show(name: str) -> None:
    """Print a built-in scene, comments included."""
    from transopt.scene import builtin

    typer.echo(builtin.scene_path(name).read_text(encoding="utf-8"), nl=False)


FORCE_HELP = "Write over a file of that name."
ACCEPT_HELP = "Take numbers that no device and no tap has as they are: the scene's implausible = accept."


@app.command("new", epilog="Example: transopt scene new mine.toml --from own_taps")
def scene_new(
    file: Path,
    source: Annotated[str, typer.Option("--from", help="Built-in scene to copy.")] = DEFAULT_SCENE,
    model: Annotated[
        Path | None, typer.Option(help="Model file of transopt identify, which the scene shall be solved with.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help=FORCE_HELP)] = False,
) -> None:
    """Copy a built-in scene to a file of your own, to be changed and solved by its path."""
    from transopt.scene import builtin
    from transopt.scene.model_file import on_model

    # Relative paths of a scene count from its own folder, those of a copy from that of the copy.
    text = builtin.scene_path(source).read_text(encoding="utf-8").replace('"../', '"')
    if model is not None:
        # What the scene would be refused for is said before there is a file.
        text = on_model(text, model, file.parent, builtin.load_scene(source, model=model).grid.grips_N)
    write_new(file, text, force=force)
    typer.echo(f"{file} written; edit it, then: transopt solve {shlex.quote(str(file))}")


def write_new(file: Path, text: str, *, force: bool, ending: str = ".toml") -> None:
    """Write a scene file, or one with another `ending`, that is not there, or in the place of one that is.

    Raises
    ------
    InputError : it is there and `force` is not set, has another suffix, or cannot be written.
    """
    if file.suffix != ending:
        what = "a scene file" if ending == ".toml" else "it"
        raise InputError(f"{file}: {what} ends in {ending}: name it {file.with_suffix(ending)}")
    try:
        with file.open("w" if force else "x", encoding="utf-8") as new:
            new.write(text)
    except FileExistsError:
        raise InputError(f"{file}: exists already; choose another name, or --force writes over it") from None
    except OSError as error:
        raise InputError(f"{file}: cannot be written ({error.strerror}); choose another place") from None


@app.command("keys", epilog="Example: transopt scene keys mine.toml")
def scene_keys(
    scene: Annotated[str, typer.Argument(help="Built-in name or path of a .toml file.")] = DEFAULT_SCENE,
) -> None:
    """Print every number and choice that a scene may state: unit, default, value here, what is allowed."""
    from transopt.scene import builtin

    loaded = builtin.load_scene(scene)
    terminal.console().print(key_table(loaded, f"{loaded.name}: keys of a scene"))


def key_table(scene: "Scene", title: str) -> "Table":
    """The keys of `transopt.scene.keys` that apply to a scene, one a row, in the order of its tables."""
    from transopt.base.tables import Table
    from transopt.scene.keys import keys

    heads = ("key", "here", "unit", "default", "allowed", "about")
    recorded = scene.recordings.simulated is None
    apart = ("recordings.",) if scene.targets else ("targets.", *["recordings.simulated."] * recorded)
    table = Table.of(title, heads, words=heads, whole=("key",))  # a key is copied into a file

    def shown(value: object) -> str:
        return "-" if value is None else f"{value:g}" if isinstance(value, float) else str(value)

    for key in keys(scene):
        if key.path.startswith(apart):  # what this scene is made from excludes them
            continue
        words = ", ".join(key.choices)
        allowed = " or ".join(part for part in (key.bounds, words, "none" if key.optional else "") if part)
        default = "to be stated" if key.required else shown(key.default)
        table.add_row(key.path, shown(key.value), key.unit, default, allowed, key.description)
    return table

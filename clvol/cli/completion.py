"""clvol completion: prints the script by which a shell completes commands, options and scene keys."""

from __future__ import annotations

import click

SHELLS = ("bash", "zsh", "fish")


@click.command("completion", short_help="Print the script that completes clvol's words in a shell.")
@click.argument("shell", type=click.Choice(SHELLS), metavar="|".join(SHELLS))
def command(shell: str) -> None:
    """Print the completion script of a shell; commands, options, scene keys and files are completed.

    \b
    bash   eval "$(clvol completion bash)"          in ~/.bashrc
    zsh    eval "$(clvol completion zsh)"           in ~/.zshrc
    fish   clvol completion fish | source           in ~/.config/fish/config.fish
    """
    from click.shell_completion import BashComplete, FishComplete, ZshComplete

    from clvol.cli.console import say
    from clvol.cli.group import COMPLETE, cli

    known = {"bash": BashComplete, "zsh": ZshComplete, "fish": FishComplete}
    script = known[shell](cli, {}, "clvol", COMPLETE)
    # source() would start bash to query its version.
    say(script.source_template % script.source_vars())

"""``tacbench completion``: print the script for tab completion."""

from __future__ import annotations

import rich_click as click

from tacbench_cad.cli import options
from tacbench_cad.cli.common import note
from tacbench_cad.cli.completing import VARIABLE

#: For each shell, what makes it load the script whenever it starts.
INSTALL = {
    "bash": "tacbench completion bash > ~/.tacbench.bash && echo '. ~/.tacbench.bash' >> ~/.bashrc",
    "zsh": "tacbench completion zsh > ~/.tacbench.zsh && echo '. ~/.tacbench.zsh' >> ~/.zshrc",
    "fish": "mkdir -p ~/.config/fish/completions && "
    "tacbench completion fish > ~/.config/fish/completions/tacbench.fish",
}


@options.command("completion", "Help")
@options.argument("shell", options.choice(*INSTALL, metavar="SHELL"), "bash, zsh or fish.")
def command(shell: str) -> None:
    """Print the script for tab completion in your shell.

    After you have installed it, the tab key completes commands, options and values: textures, printers, run folders and
    others. Type the line for your shell once and open a new terminal. In ~/.zshrc, the line that loads the script must
    come after compinit.

    Examples:
      tacbench completion bash > ~/.tacbench.bash    # bash: write the script
      echo ". ~/.tacbench.bash" >> ~/.bashrc         # bash: load the script
      tacbench completion zsh > ~/.tacbench.zsh      # the same for zsh
      echo ". ~/.tacbench.zsh" >> ~/.zshrc
      tacbench completion fish > ~/.config/fish/completions/tacbench.fish
    """
    from click.shell_completion import get_completion_class

    script = get_completion_class(shell)
    assert script is not None
    click.echo(script(click.Command("tacbench"), {}, "tacbench", VARIABLE).source())
    note(f"Next: {INSTALL[shell]}")

"""What every part of the project uses: errors, files, settings, processes, optional packages."""

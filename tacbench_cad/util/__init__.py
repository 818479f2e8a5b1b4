"""What every part of the project uses: errors, files and documents from outside, processes, optional packages."""

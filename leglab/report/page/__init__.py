"""What all pages share: the shell, the style sheet, tables, plots and scripts."""

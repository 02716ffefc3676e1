"""The common parts of all pages: shell, style sheet, tables, sections, wording, scripts."""

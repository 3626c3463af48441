"""Scenes x edits x methods -> numbers, tables, figures."""

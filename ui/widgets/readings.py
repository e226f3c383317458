"""Numbers with their names in two columns."""

from collections.abc import Iterable

from imgui_bundle import imgui


def readings(table: str, rows: Iterable[tuple[str, str, str]]) -> None:
    """Draw a table of names and values; the third of each row is the tooltip of its name. `table` is its label."""
    if not imgui.begin_table(table, 2, imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop):
        return
    for name, value, help_text in rows:
        imgui.table_next_row()
        imgui.table_next_column()
        imgui.text(name)
        imgui.set_item_tooltip(help_text)
        imgui.table_next_column()
        imgui.text(value)
    imgui.end_table()

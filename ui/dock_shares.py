"""Docks keep their shares of the window when it gets another size, or opens in another one than it was closed in."""

from imgui_bundle import ImVec2, hello_imgui, imgui

_ROOT = "MainDockSpace"


class DockShares:
    """Scales the sizes of docks with the window: Dear ImGui keeps those at the sides in pixels, from file to file."""

    def __init__(self) -> None:
        self._size: tuple[float, float] | None = None
        """Size of the dock space, in pixels, in which the present sizes of the docks are their shares."""
        self._window = (0.0, 0.0)

    def update(self) -> None:
        """Scale the docks if the window has another size. Once a frame, before the docks are drawn."""
        root, window = _root(), imgui.get_main_viewport().size
        if root is None or min(root.size.x, root.size.y, window.x, window.y) <= 0:  # no layout yet, or minimized
            return
        size = root.size.x, root.size.y
        if self._size is None and not _docks():  # the default layout is made in the first frames
            return
        if self._size is None:  # of the last frame, or as it was stored
            self._size, self._window = size, (window.x, window.y)
        size = size[0] + window.x - self._window[0], size[1] + window.y - self._window[1]
        self._window = window.x, window.y
        if size == self._size or min(size) <= 0:
            return
        x, y = size[0] / self._size[0], size[1] / self._size[1]
        for node in _docks().values():
            node.size_ref = ImVec2(x * node.size_ref.x, y * node.size_ref.y)
        self._size = size


def _root() -> imgui.internal.DockNode | None:
    docking = hello_imgui.get_runner_params().docking_params
    identity = docking.dock_space_id_from_name(_ROOT)
    node = imgui.internal.dock_builder_get_node(identity) if identity else None
    return None if node is None else imgui.internal.dock_node_get_root_node(node)


def _docks() -> dict[int, imgui.internal.DockNode]:
    """Return the docks of the window by their identity, with those that they are parts of, but for the whole."""
    docking, found = hello_imgui.get_runner_params().docking_params, dict[int, imgui.internal.DockNode]()
    identities = [docking.dock_space_id_from_name(each.new_dock) for each in docking.docking_splits]
    windows = [imgui.internal.find_window_by_name(each.label) for each in docking.dockable_windows]
    identities += [each.dock_id for each in windows if each is not None]
    for identity in filter(None, identities):
        node = imgui.internal.dock_builder_get_node(identity)
        while node is not None and node.parent_node is not None:
            found[node.id_] = node
            node = node.parent_node
    return found

"""What the session asks: one modal window with a sentence and a button for each answer."""

from imgui_bundle import ImVec2, imgui

from gsrain_engine.session.questions import Answer, Question
from gsrain_engine.session.session import Session

from ..widgets.file_dialogs import SCENE_FOLDERS, ask_where_to_save

_WIDTH_EM = 34.0


def draw_questions(session: Session) -> None:
    """Draw the present question until it is answered, and the dialog for a place where one is wanted."""
    wanted, session.files.place_wanted = session.files.place_wanted, None
    if wanted is not None:
        ask_where_to_save("Save the scene", SCENE_FOLDERS, lambda chosen: wanted(chosen[0]))
    question = session.questions.present
    _let_keys_choose(question is not None)
    if question is None:
        return
    session.view.dialog = ""  # nothing else is on top of it
    if not imgui.is_popup_open(question.title):
        imgui.open_popup(question.title)
    imgui.set_next_window_size(ImVec2(_WIDTH_EM * imgui.get_font_size(), 0))
    imgui.set_next_window_pos(imgui.get_main_viewport().get_center(), imgui.Cond_.always, ImVec2(0.5, 0.5))
    flags = imgui.WindowFlags_.no_resize | imgui.WindowFlags_.no_move | imgui.WindowFlags_.no_collapse
    if not imgui.begin_popup_modal(question.title, None, flags | imgui.WindowFlags_.no_saved_settings)[0]:
        return
    imgui.spacing()
    imgui.text_wrapped(question.text)
    if question.progress is not None:
        progress = question.progress()
        imgui.spacing()
        imgui.progress_bar(progress.fraction, ImVec2(-1, 0), f"{progress.message}: {100 * progress.fraction:.0f} %")
    imgui.spacing()
    imgui.spacing()
    given = _given(question)
    if given is not None:
        imgui.close_current_popup()
    imgui.end_popup()
    if given is not None:
        session.questions.answer(given)


def _given(question: Question) -> Answer | None:
    """Draw the buttons, from the right edge on; returns the answer of this frame."""
    style = imgui.get_style()
    least = 6 * imgui.get_font_size()
    widths = [
        max(least, imgui.calc_text_size(each.label).x + 2 * style.frame_padding.x + imgui.get_font_size())
        for each in question.answers
    ]
    wide = sum(widths) + style.item_spacing.x * (len(widths) - 1)
    imgui.set_cursor_pos_x(imgui.get_cursor_pos_x() + max(0.0, imgui.get_content_region_avail().x - wide))
    given: Answer | None = None
    for n, (answer, width) in enumerate(zip(question.answers, widths, strict=True)):
        if n > 0:
            imgui.same_line()
        if imgui.button(answer.label, ImVec2(width, 0)):
            given = answer
        if n == 0:
            imgui.set_item_default_focus()
            if imgui.is_window_appearing():  # Enter and Space act on what the cursor is on, where it is visible
                imgui.set_nav_cursor_visible(question.enter_answers)
        keys = {0: " (Enter)" if question.enter_answers else "", len(question.answers) - 1: " (Escape)"}.get(n, "")
        imgui.set_item_tooltip(f"{answer.help or answer.label}{keys}")
    if imgui.is_key_pressed(imgui.Key.escape):
        return question.answers[-1]
    if given is not None:
        return given
    is_entered = imgui.is_key_pressed(imgui.Key.enter) or imgui.is_key_pressed(imgui.Key.keypad_enter)
    if is_entered and question.enter_answers:
        return question.answers[0]
    return None


def _let_keys_choose(is_asking: bool) -> None:
    """Let Tab and the arrows go from answer to answer while something is asked; else they are keys of the view."""
    io, keyboard = imgui.get_io(), int(imgui.ConfigFlags_.nav_enable_keyboard)
    io.config_flags = io.config_flags | keyboard if is_asking else io.config_flags & ~keyboard

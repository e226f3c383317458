"""What went wrong with an agent that lives in another program."""


class ClientError(ValueError):
    """The other program is gone, silent, or answers what is no plan: the drive can't go on."""

"""Attribution of what rain does to a detector or driver: the share of each factor, such as streaks or water on glass."""

"""Attribution of what rain does to detectors and drivers: shares of its factors, such as streaks or water on glass."""

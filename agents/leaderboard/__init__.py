"""The leaderboard: entries as folders, which are run again before they stand in its page."""

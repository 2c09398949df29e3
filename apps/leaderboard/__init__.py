"""The leaderboard: entries as folders of data, and rounds on fresh episodes."""

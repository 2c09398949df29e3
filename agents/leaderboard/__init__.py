"""The leaderboard: entries as folders, their verification, and the page of verified entries."""

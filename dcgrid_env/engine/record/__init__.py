"""Episodes as they are recorded: series, streaming metrics and Parquet files."""

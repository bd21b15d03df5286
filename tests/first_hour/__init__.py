"""What a user meets in the first hour: logs, files and options as they come, wrong ones too."""

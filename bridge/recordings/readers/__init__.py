"""One reader for each format of recordings: quick to import, what reads the files is imported when it reads."""

// Sentences of the pages: buttons, topics and the summary of a drive. No logic beyond filling in.

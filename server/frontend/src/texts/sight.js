// Sentences of the pages: pictures, overlays, battery and diagnostics. No logic beyond filling in.

"""The page that `touchnet view` shows and saves: one file of HTML, CSS and JavaScript that draws with WebGL 2.

`scene` says what is on it, `page` puts it into one file, `server` serves it to a browser on this machine. The page
loads nothing else: its content security policy forbids it.
"""

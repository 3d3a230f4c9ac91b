"""What `touchnet evaluate` is made of: which reconstructions are asked, how they are run, measured, averaged, shown."""

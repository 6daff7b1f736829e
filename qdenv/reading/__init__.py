"""Reading what lies on disk: limits first, then the form, then typed records; damage is one line.

Everything here raises `InputError` where a file cannot be read and its subclass `DamagedError`
where it holds something else than was once written; the line names the file and the field.

    files   bytes and text of a limited size
    json    objects: nesting and counts are looked at before anything is parsed, then cattrs
            checks every field against a record type
    tables  CSV: the columns and every cell against a record type
    zips    archives: the directory is looked at before it is read, members before they are expanded
    arrays  .npz: headers are checked against columns before anything is allocated
"""

"""The contest of surrogates as a study: seven regressors on the runs of an archive.

    commands  `bladetwin study contest`
    tables    its result in Markdown, the published finding beside
    plots     predicted against true tip elongation; errors by contestant

The science is `core.surrogate.contest`; nothing here is fitted.
"""

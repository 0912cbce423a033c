"""The editing benchmark: build a manifest of scenes and edits, run methods on it, report.

build   folder of photos | generated scenes  ->  manifest.json          (`build_photos`, `build_generated`)
run     manifest, editor, reconstructor      ->  results.jsonl, pictures   (`runner`, `one_item`)
report  folders of results                   ->  tables, plots, a page    (`report`)
"""

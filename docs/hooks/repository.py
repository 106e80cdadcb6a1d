"""Links to the repository and to its issues, once `repository` of mkdocs.yml has its address."""


def on_config(config):
    address = config.extra["repository"]
    if address:
        links = [{"Repository": address}, {"Issues": f"{address}/issues"}]
        config.nav.append({"Source": links})
    return config

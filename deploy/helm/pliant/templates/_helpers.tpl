{{/* The name of everything: the release's, with the chart's unless it has it already. */}}
{{- define "pliant.name" -}}
{{- if contains .Chart.Name .Release.Name -}}
{{- .Release.Name | trunc 50 | trimSuffix "-" -}}
{{- else -}}
{{- printf "%s-%s" .Release.Name .Chart.Name | trunc 50 | trimSuffix "-" -}}
{{- end -}}
{{- end -}}

{{/* What pods are found by. */}}
{{- define "pliant.selector" -}}
app.kubernetes.io/name: pliant
app.kubernetes.io/instance: {{ .Release.Name }}
{{- end -}}

{{- define "pliant.labels" -}}
{{ include "pliant.selector" . }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
helm.sh/chart: {{ printf "%s-%s" .Chart.Name .Chart.Version }}
{{- end -}}

{{- define "pliant.scheme" -}}
{{- if .Values.tls.secret }}https{{ else }}http{{ end -}}
{{- end -}}

{{/* Which probe asks what. */}}
{{- define "pliant.asks" -}}
httpGet:
  path: {{ .path }}
  port: pliant
  {{- if .root.Values.tls.secret }}
  scheme: HTTPS
  {{- end }}
{{- end -}}
